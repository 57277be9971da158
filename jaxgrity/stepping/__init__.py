"""The equations of motion and the methods that integrate them, for studies of one's own.

`simulate.simulate` is where to begin reading: checks of the start (`starts`), options (`options`, `methods`,
`step_limits`), diffrax (`discretisation`), forces (`dynamics`), constraints (`complementarity`, then `swept` or
`coupled_stepping`), frames (`frame_velocities`).
"""

from jaxgrity.core.public_names import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
