"""jaxgrity: tensegrity robots, simulated differentiably, and the gaits that make them roll.

The public names stand in `__init__.pyi`, in groups; each module is imported when one of its names is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
