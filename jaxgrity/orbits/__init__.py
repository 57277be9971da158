"""The orbits that rolling robots settle on: their speed, their stability, and derivatives of both."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
