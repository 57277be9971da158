"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll.

The public names stand in `__init__.pyi`, in groups; each module is imported when one of its names is first used.
"""

import sys
from types import ModuleType

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _Package(ModuleType):
    """Keeps the name `rollout` for the function: Python would give it to the sub-package once that is imported."""

    @property
    def rollout(self):
        from jaxgrity.stepping.rollout import rollout

        return rollout

    @rollout.setter
    def rollout(self, sub_package):
        pass


sys.modules[__name__].__class__ = _Package
