"""What everything else is made of."""

from jaxgrity.core import primitives

__all__ = ["primitives"]
