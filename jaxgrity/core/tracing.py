"""Whether numbers are known, or only stand for those of a function that is being differentiated or compiled."""

from typing import Any

import jax


def traced(tree: Any) -> bool:
    """Whether any number of it is a tracer, whose value is not known."""
    return any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(tree))
