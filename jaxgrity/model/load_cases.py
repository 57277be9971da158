"""Static loads at nodes, as named cases."""

import equinox as eqx
import numpy as np

from jaxgrity.core.arguments import check_each, check_index
from jaxgrity.core.errors import InputError
from jaxgrity.core.types import Rows, as_float


class LoadCase(eqx.Module):
    """Constant forces at nodes. Load cases are alternatives, for statics; they do not act in motions."""

    name: str = eqx.field(static=True)
    nodes: tuple[int, ...] = eqx.field(static=True)
    """numbers of the loaded nodes; forces on a node that is named twice add up"""
    force: Rows = eqx.field(converter=as_float)
    """(loaded nodes, 3), force on each of these nodes, N"""

    def __check_init__(self):
        if not isinstance(self.name, str) or not self.name:
            raise InputError(f"load_case.name = {self.name!r}: expected a name")
        for k, node in enumerate(self.nodes):
            check_index(f"load_case.nodes[{k}]", node)
        check_each("load_case.force", self.force, shape=(len(self.nodes), 3))

    def on_nodes(self, nodes: int) -> np.ndarray:
        """(nodes, 3), N: the force on each node of the structure."""
        found = np.zeros((nodes, 3))
        np.add.at(found, list(self.nodes), np.asarray(self.force, float))
        return found


def check_load_cases(cases: tuple[LoadCase, ...], nodes: int) -> None:
    """Raises `InputError` for what is no load case, two of one name, or a node that a structure of so many lacks."""
    for case in cases:
        if not isinstance(case, LoadCase):
            raise InputError(f"loads has {case!r}; expected a LoadCase")
    names = [case.name for case in cases]
    if len(set(names)) < len(names):
        raise InputError(f"loads are called {', '.join(names)}; expected another name for each load case")
    for case in cases:
        for k, node in enumerate(case.nodes):
            check_index(f"load case {case.name!r}: nodes[{k}]", node, nodes)
