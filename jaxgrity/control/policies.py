"""Policies: from a robot's observations to its motors' commands."""

from abc import abstractmethod
from typing import TYPE_CHECKING, Any

import equinox as eqx

from jaxgrity.control.sensors import Observation
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import PerActuator, Scalar
from jaxgrity.model.actuation import Gait, check_robot, contraction
from jaxgrity.model.scene import Scene

Memory = Any
"""Any tree of arrays that a policy carries from one control period to the next."""


class Policy(eqx.Module):
    """A differentiable function from observations to commands; its arrays are its parameters.

    It is written for one robot. Rollouts map it over populations and differentiate it.
    """

    if TYPE_CHECKING:  # type checkers would not let a property take the place of a field

        @property
        def members(self) -> tuple[int, ...]: ...
    else:
        members: eqx.AbstractVar[tuple[int, ...]]
    """which members it actuates, as in a `Gait`"""

    @abstractmethod
    def first(self) -> Memory:
        """The memory before the first control period."""

    @abstractmethod
    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        """The commanded contraction of each member at time t, s, the end of the coming control period."""

    def check(self, scene: Scene) -> None:
        """Raise `InputError` where it cannot drive the robot of a scene; by default, where a policy in it cannot."""
        for part in vars(self).values():
            if isinstance(part, Policy):
                part.check(scene)


def check_gait(gait: Gait) -> None:
    """Raise `InputError` for another type than a gait, such as a gait's name."""
    if not isinstance(gait, Gait):
        raise InputError(f"gait = {gait!r}: expected a Gait, such as load_gait('lasting')")


class OpenLoop(Policy):
    """A gait, independent of observations. Raises `InputError` for another type than a gait."""

    gait: Gait

    def __check_init__(self):
        check_gait(self.gait)

    @property
    def members(self) -> tuple[int, ...]:
        return self.gait.members

    def first(self) -> Memory:
        return ()

    def check(self, scene: Scene) -> None:
        check_robot(self.gait, scene.structure)

    def __call__(self, observation: Observation, t: Scalar, memory: Memory) -> tuple[PerActuator, Memory]:
        return contraction(self.gait, t), memory
