"""Arguments: one rule for each kind, and one line for what breaks it."""

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxgrity import InputError, Members, edge_lengths, statics
from jaxgrity.core import arguments
from jaxgrity.core.types import as_float


@pytest.mark.parametrize("bad", [2.5, -1, "2", True, np.nan, None, [1]])
def test_counts_and_indices_are_whole_numbers(bad):
    with pytest.raises(InputError, match=r"here = .*: expected a whole number, at least 0"):
        arguments.check_count("here", bad, 0)
    with pytest.raises(InputError, match=r"here = .*: expected a whole number from 0 to 9"):
        arguments.check_index("here", bad, 10)
    assert arguments.check_count("here", np.int32(3), 0) == arguments.check_index("here", 3, 4) == 3


def test_an_index_is_less_than_there_are_and_comes_once():
    with pytest.raises(InputError, match=r"nodes\[1\] = 4: expected a whole number from 0 to 3"):
        arguments.check_indices("nodes", (0, 4), 4)
    with pytest.raises(InputError, match=r"nodes = \[1, 1\]: expected each number once"):
        arguments.check_indices("nodes", [1, 1])
    with pytest.raises(InputError, match="nodes = 1: expected a list of whole numbers"):
        arguments.check_indices("nodes", 1)
    with pytest.raises(InputError, match=r"nodes\[0\] = 4: expected a whole number from 0 to 3"):
        arguments.check_indices("nodes", np.array([4]), 4)
    assert arguments.check_indices("nodes", np.array([2, 0]), 3) == (2, 0)


@pytest.mark.parametrize("edge", [(0, 3), (-1, 2), (0, 1.5), (0, np.nan)])
def test_members_end_at_nodes_that_there_are(edge):
    """Where lengths and matrices are asked of plain arrays, too."""
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusals would come first
    message = rf"edges\[1\] = \[{edge[0]}(.0)?, {edge[1]}\]: expected two nodes from 0 to 2"
    for asked in (edge_lengths, statics.equilibrium_matrix):
        with pytest.raises(InputError, match=message):
            asked(np.eye(3), ((0, 1), edge))
    with pytest.raises(InputError, match=r"edges have shape \(1, 3\); expected \(members, 2\)"):
        edge_lengths(np.eye(3), ((0, 1, 2),))
    assert edge_lengths(np.eye(3), ()).shape == (0,)


@pytest.mark.parametrize("bad", [np.nan, np.inf, "half", None, True, [1.0], 1j])
def test_a_number_is_one_finite_number(bad):
    with pytest.raises(InputError, match=r"size = .* m: expected a positive number"):
        arguments.check_number("size", bad, above=0.0, unit="m")


def test_bounds_of_a_number_are_said():
    with pytest.raises(InputError, match="x = -1: expected a finite number, at least 0"):
        arguments.check_number("x", -1, least=0.0)
    with pytest.raises(InputError, match="x = 1: expected a finite number above 2"):
        arguments.check_number("x", 1.0, above=2.0)
    assert arguments.check_number("x", np.array(3), above=2.0) == 3.0


def test_arrays_have_a_shape_finite_numbers_and_bounds():
    """None is fine, and so is what is being traced, but for its shape."""
    with pytest.raises(InputError, match=r"way has shape \(2,\); expected \(3,\)"):
        arguments.check_each("way", [1, 2], shape=(3,))
    with pytest.raises(InputError, match=r"way has shape \(1,\); expected one number"):
        jax.jit(lambda x: arguments.check_each("way", x, shape=()))(np.ones(1))
    with pytest.raises(InputError, match=r"way\[1\] = nan: expected a finite number"):
        arguments.check_each("way", [1, np.nan, 2])
    with pytest.raises(InputError, match=r"way\[0, 1\] = -1 m: expected a finite number, at least 0"):
        arguments.check_each("way", [[1, -1]], least=0.0, unit="m")
    with pytest.raises(InputError, match="share = 2: expected a number from 0 to 1"):
        arguments.check_each("share", 2, least=0.0, most=1.0)
    with pytest.raises(InputError, match=r"up = .*: 1.1 long; expected a unit vector"):
        arguments.check_unit_vector("up", np.array([0, 0, 1.1]))
    arguments.check_unit_vector("up", np.array([0, 0.6, 0.8]))
    arguments.check_each("way", None, shape=(3,))
    jax.jit(lambda x: arguments.check_each("way", x, shape=(), above=0.0))(-1.0)
    with pytest.raises(InputError, match="heights: expected rows of numbers, all of one length"):
        arguments.as_table("heights", [[1, 2], [3]])


@pytest.mark.parametrize("bad", ["1.0", True, 1j, None, [[1], [1, 2]], [True]])
def test_what_is_no_number_does_not_become_one(bad):
    """NumPy would make 1.0 of text and of truth values."""
    with pytest.raises(InputError, match="expected numbers"):
        as_float(bad)


def test_lists_of_traced_numbers_are_numbers():
    """The derivative of a sum of 3 k and of k + 0.5 goes through the lists."""

    def total(k):
        made = Members(((0, 1), (1, 2)), [k, 2 * k], [k, 0.5])
        return jnp.sum(made.stiffness) + jnp.sum(made.rest_length)

    assert jax.grad(total)(1.0) == 4.0


def test_the_first_number_of_a_tree_that_is_none_is_named_by_its_path():
    """Those of JAX where asked; those that are traced never."""
    tree = {"a": (np.ones(2), np.array([[1.0, np.nan]]))}
    with pytest.raises(InputError, match=r"part\['a'\]\[1\]\[0, 1\] = nan: expected a finite number"):
        arguments.check_all_finite(tree, "part")
    device = {"a": jnp.array([np.inf])}
    arguments.check_all_finite(device)
    with pytest.raises(InputError, match=r"\['a'\]\[0\] = inf"):
        arguments.check_all_finite(device, on_devices=True)
    jax.jit(lambda x: arguments.check_all_finite(x, on_devices=True))(device)
