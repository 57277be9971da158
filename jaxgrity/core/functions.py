"""Functions among the numbers of a law or a policy, such as the activation of a network."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax


class Held(eqx.Module):
    """A function that is no leaf: transformations of numbers ignore it."""

    function: Callable = eqx.field(static=True)

    def __call__(self, *given: Any, **named: Any) -> Any:
        return self.function(*given, **named)


def hold_functions(tree: Any) -> Any:
    """The tree, a scene or a policy, with its functions held."""
    return jax.tree.map(lambda x: x if eqx.is_array_like(x) else Held(x), tree)
