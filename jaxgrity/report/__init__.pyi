from . import plot, view
from .animation import animate
from .steady import steady_facts
from .view import Replay, Robot

__all__ = [
    "Replay",
    "Robot",
    "animate",
    "plot",
    "steady_facts",
    "view",
]
