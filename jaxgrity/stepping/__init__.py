"""The equations of motion and the methods that integrate them, for studies of one's own.

`simulate.simulate` is where to begin reading: options (`options`, `methods`, `step_limits`), start (`starts`), diffrax
(`discretisation`), forces (`dynamics`), constraints (`complementarity`, then `swept` or `coupled_stepping`).
"""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
