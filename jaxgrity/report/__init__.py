"""Pictures and pages."""

from jaxgrity.report import plot, view

__all__ = ["plot", "view"]
