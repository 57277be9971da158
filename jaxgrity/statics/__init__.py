"""Does it stand, how, and how stiffly: form-finding, self-stress, resting shapes, vibrations."""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
