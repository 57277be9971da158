"""Arguments of the wrong kind are refused in one line, by every public function and before anything else."""

import inspect
import re
from importlib import import_module
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from beartype import beartype

import jaxgrity
from jaxgrity import (
    InputError,
    Scene,
    SolverOptions,
    edge_lengths,
    load_gait,
    load_scene,
    rollout,
    save_scene,
    simulate,
    with_gait,
)
from jaxgrity.core.typed import check_fields, kinds_of, typed
from jaxgrity.core.types import Scalar

ROOMS = ["jaxgrity", *(f"jaxgrity.{room}" for room in jaxgrity.SUB_PACKAGES)]


def _looked_at(kind):
    return kind is Path or kind.__module__.startswith("jaxgrity")


def _parameters():
    """Of all public functions, those whose annotation is a class of ours or a file."""
    for room in map(import_module, ROOMS):
        for name in room.__all__:
            if callable(function := getattr(room, name)) and not inspect.isclass(function):
                for parameter in inspect.signature(function).parameters.values():
                    if any(map(_looked_at, kinds_of(parameter.annotation))):
                        yield pytest.param(function, parameter.name, id=f"{name}-{parameter.name}")


def test_the_parameters_are_found():
    """Else the test below could not fail."""
    found = {case.id for case in _parameters()}
    assert len(found) > 200
    assert {"simulate-scene", "simulate-options", "save_scene-path", "with_gait-gait", "rolling-trajectory"} <= found


@pytest.mark.parametrize(("function", "name"), list(_parameters()))
def test_every_public_function_looks_at_the_kinds_of_its_arguments(function, name):
    """Before it misses the others; what is jitted looks when it is traced."""
    looks = function if inspect.isfunction(function) else function.__wrapped__
    with pytest.raises(InputError, match=rf"^\w+: {name} is an object; expected ") as refused:
        looks(**{name: object()})
    assert "\n" not in str(refused.value)


def test_parts_of_whole_numbers_are_refused():
    """Before they are a raw error of what counts with them."""

    @typed
    def counted(seed: int, share: int | float = 0) -> int:
        return int(seed)

    assert counted(3, 0.5) == counted(np.int64(3)) == 3
    for seed in (0.5, np.float64(0.5), np.float32(2.5), np.nan, np.inf):
        with pytest.raises(InputError, match=r"counted: seed is .*; expected a whole number"):
            counted(seed)


def test_arrays_are_no_single_numbers(scene):
    """Of NumPy and of JAX; an array without axes is one number."""
    for several in (np.ones(2), jnp.ones(1), np.ones((1, 1))):
        message = re.escape(f"simulate: duration is an array of shape {several.shape}; expected a number")
        with pytest.raises(InputError, match=message):
            simulate(scene, several)

    @typed
    def doubled(x: float) -> float:
        return 2 * x

    assert doubled(np.array(1.5)) == doubled(jnp.array(1.5)) == 3


@pytest.fixture(scope="module")
def scene():
    return load_scene("reference")


def _refused(function, *given, **named):
    with pytest.raises(InputError) as refused:
        function(*given, **named)
    return str(refused.value)


def test_the_message_says_what_to_pass(scene, tmp_path):
    path = tmp_path / "scene.toml"
    assert _refused(simulate, "reference", 1.0) == (
        "simulate: scene is 'reference'; expected a Scene; pass jaxgrity.load_scene('reference')"
    )
    assert _refused(rollout, path, np.array([0.0, 1.0])).endswith(f"pass jaxgrity.load_scene({str(path)!r})")
    assert _refused(with_gait, scene, "straight").endswith("pass jaxgrity.load_gait('straight')")
    assert _refused(simulate, scene, 1.0, options={"dt": 1e-3}).endswith("pass SolverOptions(dt=0.001)")
    assert _refused(simulate, scene, 1.0, options=SolverOptions).startswith("simulate: options is the class Solver")
    assert _refused(with_gait, scene, scene) == "with_gait: gait is a Scene; expected a Gait or None; pass its gait"
    assert _refused(save_scene, path, scene).endswith("expected a Scene; one was given as path")
    assert _refused(simulate, scene, "1") == "simulate: duration is '1'; expected a number"
    assert _refused(load_scene, 3) == "load_scene: scene is 3; expected text or a path"
    assert _refused(load_gait, None) == "load_gait: name is None; expected text or a path"
    assert not path.exists()


def test_a_scene_is_made_of_what_it_says(scene):
    jaxtyping.config.update("jaxtyping_disable", True)  # for this test: its own refusals would come first
    assert _refused(Scene, "x") == "Scene: structure is 'x'; expected a Structure"
    assert _refused(Scene, scene) == "Scene: structure is a Scene; expected a Structure; pass its structure"
    assert _refused(Scene, scene.structure, ground=scene.gait) == "Scene: ground is a Gait; expected a Ground or None"


def test_what_fits_goes_through():
    """Numbers of any kind, classes made from the one that is expected, arrays unseen, whatever a star takes."""

    class Special(Scene):
        more: float = eqx.field(static=True, default=0.0)

    @typed
    def given(scene: Scene, duration: float, array: np.ndarray | None = None, *more: Scene):
        return more

    scene = Special(load_scene("exact").structure)
    for number in (1, 1.0, True, np.float32(1), np.ones(())):
        assert given(scene, number, "no array", scene, scene) == (scene, scene)
    assert _refused(given, scene, 1.0, None, scene, 3).startswith("given: more is 3; expected a Scene")


def test_fields_take_the_values_of_several_at_once():
    """A policy with an array of bends, as `lead_to` samples them; a field of the module's own kinds stays checked."""

    class Pair(eqx.Module):
        gain: Scalar
        count: int = 1

        def __check_init__(self):
            check_fields(self)

    assert Pair(jnp.zeros(3)).gain.shape == (3,)
    with pytest.raises(InputError, match=r"^Pair: count is an array of shape \(3,\); expected a whole number$"):
        Pair(0.0, np.zeros(3))
    with pytest.raises(InputError, match=r"^Pair: gain is 'much'; expected a number"):
        Pair("much")


def test_shapes_are_checked_in_fast_tests():
    """Once for each kind of arguments: what has passed makes nothing else pass, in inner functions too."""
    q = np.array([[0.0, 0, 0], [1, 0, 0]])
    for _ in range(2):
        assert edge_lengths(q, ((0, 1),)).tolist() == [1.0]
        for wrong in (q[:, :2], q[0], q.astype(bool)):
            with pytest.raises(jaxtyping.TypeCheckError, match="edge_lengths"):
                edge_lengths(wrong, ((0, 1),))

    def outer(columns: int):
        @jaxtyping.jaxtyped(typechecker=beartype)
        def inner(x: jaxtyping.Float[np.ndarray, "n 3"], how: str = "") -> jaxtyping.Float[np.ndarray, " n"]:
            return x[:, 0] if columns else x

        return inner

    assert outer(1)(q, how="here").shape == (2,)
    with pytest.raises(jaxtyping.TypeCheckError, match="parameters"):
        outer(1)(q.T)
    with pytest.raises(jaxtyping.TypeCheckError, match="return value"):
        outer(0)(np.zeros((3, 3)))
