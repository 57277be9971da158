"""The orbits that rolling robots settle on: their speed, their stability, and derivatives of both."""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
