"""Types and shapes of arguments and results, checked once for each kind of arguments that a function gets.

By itself jaxtyping makes a checker for every function, for inner ones at each call of the outer one, and checks every
call: together an eighth of the time of the fast tests. Whoever imports this module changes that for all modules of the
package that are imported later.
"""

from collections import defaultdict
from collections.abc import Callable, Hashable
from functools import partial, wraps
from types import FunctionType
from typing import Any

import jax
import jaxtyping
import numpy as np

_CHECKED: defaultdict[Any, set[Hashable]] = defaultdict(set)
"""Kinds of arguments for which a call passed all checks, by the code of the function."""


def _decorated(jaxtyped: Callable, function: Any = None, *, typechecker: Callable) -> Any:
    if function is None:
        return partial(_decorated, jaxtyped, typechecker=typechecker)
    if not isinstance(function, FunctionType):
        return jaxtyped(function, typechecker=typechecker)
    passed, config = _CHECKED[function.__code__], jaxtyping.config
    # at once, for jaxtyping leaves out what names a class that is not there yet; of inner functions, once it is needed
    checker = [] if "<locals>" in function.__qualname__ else [jaxtyped(function, typechecker=typechecker)]

    @wraps(function)
    def called(*args, **kwargs):
        if config.jaxtyping_disable:
            return function(*args, **kwargs)
        try:
            kind = (*map(_kind, args), *((name, _kind(x)) for name, x in kwargs.items()))
            known = kind in passed
        except TypeError:  # a kind without a hash
            kind, known = None, False
        if known:
            return function(*args, **kwargs)
        if not checker:
            checker.append(jaxtyped(function, typechecker=typechecker))
        found = checker[0](*args, **kwargs)
        if kind is not None:
            passed.add(kind)
        return found

    return called


def _kind(x: Any) -> Hashable:
    """What decides whether an argument passes: a string; type, shape and dtype of an array; the first parts of a tuple,
    of which beartype looks at one; those of a dictionary. Of anything else the type counts."""
    if isinstance(x, str):
        return x
    if type(x) in (tuple, list):
        return (type(x), len(x), *map(_kind, x[:4]))
    if type(x) is dict:
        return (dict, *((key, _kind(value)) for key, value in x.items()))
    return (type(x), x.shape, x.dtype) if isinstance(x, np.ndarray | np.generic | jax.Array) else type(x)


jaxtyping.jaxtyped = partial(_decorated, jaxtyping.jaxtyped)
