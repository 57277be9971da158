"""Members of a scene as tendons of a MuJoCo model, and their actuators."""

from typing import Any
from xml.etree import ElementTree

import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import PerMember
from jaxgrity.formats.foreign import add_element
from jaxgrity.formats.mjcf_plan import Plan, amplitudes
from jaxgrity.model.clusters import cables_of, nodes_along
from jaxgrity.model.force_laws import CableDampers, DeadBand, ForceLimit, ForceTable
from jaxgrity.model.pulls import forced_cables
from jaxgrity.model.scene import Scene
from jaxgrity.model.stiffening import polynomial_terms

STRONGEST = 1e9
"""Limit of a cable's force in an MJCF file, N, from which on it counts as none: no cable of a robot reaches it."""
BARE = (0.0, 0.0, 0.0, 0.0, np.inf, 0.0, 0.0)
"""What is beside a strut, as `_beside_cables` has it."""


def add_members(root: ElementTree.Element, scene: Scene, plan: Plan) -> list[str]:
    """Tendons with springs, and with actuators where a gait moves them."""
    tendons, actuators = add_element(root, "tendon"), add_element(root, "actuator")
    structure, damped, stopped, held, bent = plan.structure, False, 0, 0, 0
    size, beside, constant = amplitudes(scene.gait), _beside_cables(scene), list[dict[str, Any]]()
    for name, members, first in structure.numbered:
        kind = name.removesuffix("s")
        for cord in cables_of(members.clusters, len(members.edges)):
            k = min(cord)
            if kind == "strut" and k in plan.rigid:
                continue
            assert members.stiffness is not None, "springs, by the plan"
            K, L = _in_series(members.stiffness, cord), float(np.sum(members.rest_length[list(cord)]))
            c = 0.0 if members.damping is None else _in_series(members.damping, cord)
            band, damper, pull, slope, most, *bends = beside[k] if kind == "cable" else BARE
            ends = [max(L - band, 0.0), L]
            name, driven = f"{kind}{k}", first + k in plan.actuated
            # as they are read again: the damping of a tendon that never pushes is that of a taut cable
            limited = bool(K) and most < STRONGEST
            own = not K or (band < L and not driven)
            both = c + damper if own else c
            bent += bool(any(bends) and (driven or limited or band < L))
            whole = K if not any(bends) or band < L else [K, K * bends[0], K * bends[1]]
            spring: dict[str, Any] = {"stiffness": whole, "damping": both, "springlength": ends if band else L}
            forced = bool(pull or slope) and not K
            held += bool(K and slope and driven)
            if (pull and K) or (forced and not driven):
                constant.append(_pull(f"pull{k}", name, (pull, 0.0 if K else slope), L))
            if driven and forced:
                add_element(actuators, "general", **_pull(name, name, (pull, slope), L))
            elif driven or limited:
                # a limit holds for the spring alone: its damper is the tendon's
                spring = {"damping": both} if limited and both else {}
                stopped += 0 < band < L or (limited and band < L)
                reach = sum(size.get(first + part, 0.0) * float(members.rest_length[part]) for part in cord)
                limit = min(most, STRONGEST) if band or limited else 0.0
                servo = _servo(name, (K, L, 0.0 if limited else c), limit, reach if driven else None)
                if driven:
                    add_element(actuators, "general", **servo)
                else:
                    constant.append(servo | {"name": f"spring{k}"})
            damped = damped or bool(spring and kind == "cable" and c)
            nodes = nodes_along(tuple(members.edges[part] for part in cord))
            _tendon(tendons, name, nodes, spring)
            if damper and not own:
                _tendon(tendons, f"damper{k}", nodes, {"damping": damper})
    for force in constant:
        add_element(actuators, "general", **force)
    notes = {
        "cables are damped there while they are slack, too": damped,
        f"the pull of {held} springs beside their command does not change there": held,
        f"{stopped} cables with actuators do not push beyond their dead bands there": stopped,
        f"{bent} cables with actuators, or that push, do not grow stiffer with their stretch there": bent,
        f"{len(plan.actuated)} actuators change rest lengths by their controls (m); the gait itself is no part of it": (
            plan.actuated
        ),
    }
    return [note for note, holds in notes.items() if holds]


def _servo(name: str, law: tuple[float, float, float], limit: float, reach: float | None) -> dict[str, Any]:
    """An actuator that pushes with K (L + u - l) - c l', where l is the length of its tendon and u its control, m.

    The `law` is K, N/m, L, m, and c, N s/m.
    With a `limit`, N, it only pulls, and at most with that. `reach`: largest shortening, m; None: no control moves it.
    """
    K, L, c = law
    limits = {"forcelimited": "true", "forcerange": [-limit, 0.0]} if limit else {}
    range_of = {"ctrllimited": "true", "ctrlrange": [-reach, 0.0]} if reach else {}
    gain = {"gainprm": 0.0 if reach is None else K, "biastype": "affine", "biasprm": [K * L, -K, -c]}
    return {"name": name, "tendon": name, **gain, **limits, **range_of}


def _pull(name: str, tendon: str, force: tuple[float, float], longest: float) -> dict[str, Any]:
    """An actuator that pulls with P - s u at control u, m, from `force` P, N, and s, N/m."""
    pull, slope = force
    law = {"gainprm": slope, "biastype": "affine", "biasprm": [-pull, 0.0, 0.0]}
    limits = {"forcelimited": "true", "forcerange": [-STRONGEST, 0.0]}
    reach = {"ctrllimited": "true", "ctrlrange": [-longest, 0.0]} if slope else {}
    return {"name": name, "tendon": tendon, **law, **limits, **reach}


def _tendon(parent: ElementTree.Element, name: str, nodes: tuple[int, ...], law: dict[str, Any]) -> None:
    tendon = add_element(parent, "spatial", name=name, **law)
    for node in nodes:
        add_element(tendon, "site", site=f"n{node}")


def _beside_cables(scene: Scene) -> dict[int, tuple[float, ...]]:
    """Dead band, m, damper, N s/m, commanded pull, N, and its slope, N/m, largest force, N, and the coefficients of
    `polynomial_terms`.

    By the first segment of each cable.

    Without a dead band it never pushes.
    """
    cables = scene.structure.cables
    if cables is None:
        return {}
    cords = cables_of(cables.clusters, len(cables.edges))
    band, damper = np.full(len(cords), np.inf), np.zeros(len(cords))
    for term in scene.terms:
        if isinstance(term, DeadBand):
            band = np.minimum(band, np.asarray(term.width, float))
        elif isinstance(term, CableDampers):
            damper = damper + np.asarray(term.damping, float)
    bends, forced = polynomial_terms(scene.terms, len(cords)), forced_cables(scene)
    if np.any(np.any(bends, axis=1) & np.any(forced, axis=1)):
        raise InputError("cables: quadratic or cubic beside pull; MJCF files that are read back have one of both")
    limit = written_limit(scene)
    most = np.full(len(cords), np.inf if limit is None else np.asarray(limit.largest, float))
    rows = np.column_stack([band, damper, forced, most, bends]).tolist()
    return {min(cord): tuple(row) for cord, row in zip(cords, rows)}


def written_limit(scene: Scene) -> ForceLimit | None:
    """The largest forces that a MuJoCo model holds: those of one law, of springs that this alone bends."""
    laws = [term for term in scene.terms if isinstance(term, ForceLimit | ForceTable)]
    return laws[0] if len(laws) == 1 and isinstance(laws[0], ForceLimit) and laws[0].factors is None else None


def _in_series(values: PerMember, cord: tuple[int, ...]) -> float:
    """Of springs or dampers one after the other: 0 where one of them is."""
    own = np.asarray(values, float)[list(cord)]
    if len(own) == 1 or not np.all(own):
        return float(np.min(own))
    return float(1 / np.sum(1 / own))
