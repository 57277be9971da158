"""Pictures and pages."""

from jaxgrity.report import plot

__all__ = ["plot"]
