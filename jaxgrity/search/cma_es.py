"""CMA-ES instead of the genetic algorithm: the next generation by evosax (the extra `baselines`).

Hansen 2016, arXiv:1604.00772. CMA-ES works with angles beyond a turn, and with other genes beyond their bounds;
rollouts use the genes brought back.
"""

import importlib
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from jaxgrity.core.errors import InputError, check_known
from jaxgrity.core.types import AnyArray, PerGait

OPTIMISERS = ("genetic", "cma-es")
"""Names of the optimisers that make one generation from the last."""
WORST = 1e20
"""Cost that CMA-ES is given for a gait that failed, in place of the fitness with its sign turned."""

Memory = Float[AnyArray, " numbers"]


class Asked(NamedTuple):
    """The next request of CMA-ES."""

    genes: Float[AnyArray, "population genes"]
    """its mean first, then draws around it; not brought back to circle and bounds"""
    memory: Memory
    """all that it has learnt"""


def check_optimiser(name: str) -> None:
    """Raise `InputError` for an unknown optimiser, or one without its extra."""
    check_known("optimiser", name, OPTIMISERS)
    if name == "cma-es":
        _algorithms()


def fewest(name: str) -> int:
    """The fewest gaits of a generation: for CMA-ES its mean, and four draws around it."""
    return 2 if name == "genetic" else 5


def asked_next(
    key, genes: Float[AnyArray, "gaits genes"], fitness: PerGait, memory: Memory | None, size: int, width: float
) -> Asked:
    """The next gaits of CMA-ES, some number of them, from the fitness of the last ones.

    Without a memory it begins at the best of the gaits, with a standard deviation of `width` in every gene. Its mean is
    rolled out beside the draws, but it does not learn from the mean.
    """
    told, asked = jax.random.split(key)
    algorithm, parameters = _built(size - 1, genes.shape[1])
    empty = algorithm.init(told, jnp.zeros(genes.shape[1]), parameters.replace(std_init=jnp.asarray(float(width))))
    flat, unravel = ravel_pytree(empty)
    if memory is None:
        state = empty.replace(mean=jnp.asarray(genes[int(np.argmax(fitness))], flat.dtype))
    else:
        cost = np.where(np.isfinite(fitness), -np.asarray(fitness, float), WORST)
        some = jnp.asarray(genes[1:], flat.dtype), jnp.asarray(cost[1:], flat.dtype)
        state, _ = algorithm.tell(told, *some, unravel(jnp.asarray(memory, flat.dtype)), parameters)
    draws, state = algorithm.ask(asked, state, parameters)
    every = np.concatenate([np.asarray(state.mean)[None], np.asarray(draws)])
    return Asked(every.astype(np.asarray(genes).dtype), np.asarray(ravel_pytree(state)[0]))


@cache
def _built(population: int, size: int) -> tuple[Any, Any]:
    """The algorithm and its parameters, once for all searches: a new object would be compiled anew."""
    algorithm = _algorithms().CMA_ES(population, np.zeros(size))
    return algorithm, algorithm.default_params


def _algorithms() -> Any:
    # not at the top: it takes seconds to import, and most searches do without it
    try:
        return importlib.import_module("evosax.algorithms")
    except ImportError as error:
        said = "expected it, as by: pip install 'jaxgrity[baselines]'"
        raise InputError(f"optimiser = 'cma-es': evosax is not installed; {said}") from error
