"""The equations of motion and the methods that integrate them, for studies of one's own."""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
