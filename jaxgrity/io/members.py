"""The struts and cables of a scene file, and their laws of force, read and written."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import msgspec
import numpy as np

from jaxgrity.core.errors import InputError
from jaxgrity.core.types import AnyArray, Edges
from jaxgrity.io.member_sizes import has_sizes, members_of_sizes
from jaxgrity.io.member_tables import CablesTable, ForceKeys, MotorTable, PulleyKeys, StrutsTable, TouchingKeys
from jaxgrity.io.validation import shown
from jaxgrity.model.clusters import check_clusters
from jaxgrity.model.force_laws import (
    CableDampers,
    DeadBand,
    ForceLimit,
    ForceTable,
    cable_dampers,
    dead_band,
    first_slope,
    force_limit,
    force_table,
)
from jaxgrity.model.laws import Law
from jaxgrity.model.motors import Motor
from jaxgrity.model.pulleys import CableRoute, Pulley, built_lengths, check_pulleys, check_wraps
from jaxgrity.model.pulls import CommandedPull, commanded_pull
from jaxgrity.model.scene import Scene
from jaxgrity.model.stiffening import PolynomialStiffness, polynomial_stiffness
from jaxgrity.model.structure import Members, per_member
from jaxgrity.model.strut_contact import radius_of_struts, strut_contact, touching_like, without_strut_contact

FIELDS_OF_LAWS: dict[type, dict[str, str]] = {
    ForceLimit: {"largest_force": "largest"},
    DeadBand: {"dead_band": "width"},
    CableDampers: {"damper": "damping"},
    PolynomialStiffness: {"quadratic": "quadratic", "cubic": "cubic"},
}
"""Keys of [cables], and the fields of laws that hold the same numbers for each cable."""


def build_members(
    table: StrutsTable | CablesTable | None, edges: Edges, nodes: np.ndarray, kind: str
) -> Members | None:
    """The struts or cables, by `kind`, of their table; None without one.

    Raises `InputError` where its keys do not fit each other, or not the edges.
    """
    if not edges:
        if table is not None:
            raise InputError(f"{kind}: the structure has none; expected no [{kind}] table")
        return None
    if table is None:
        return None
    sprung = table.stiffness is not None or np.any(_or_zero(table.damping))
    if isinstance(table, StrutsTable) and table.rigid and sprung:
        raise InputError("struts.rigid = true: a rigid strut has no spring; expected neither stiffness nor damping")
    if table.prestrain is not None and table.rest_length is not None:
        strained = f"{kind}.prestrain = {shown(table.prestrain)}"
        raise InputError(f"{strained}: rest_length is given too; expected one of them")
    count = len(edges)
    way = _way_of(table, edges, nodes, kind)
    if table.rest_length is not None:
        rest = per_member(table.rest_length, count, f"{kind}.rest_length")
    else:
        prestrain = per_member(_or_zero(table.prestrain), count, f"{kind}.prestrain")
        rest = (1 - prestrain) * built_lengths(way, nodes)
    damping = per_member(_or_zero(table.damping), count, f"{kind}.damping")
    known = members_of_sizes(table, edges, rest, kind) if has_sizes(table) else _given_members(table, edges, rest, kind)
    stiffness = known.stiffness
    broken = member_numbers(table.broken, count, "cables.broken") if isinstance(table, CablesTable) else ()
    if stiffness is not None and broken:
        damping[list(broken)] = stiffness[list(broken)] = 0.0
    mass = known.mass if known.mass is not None else per_member(_or_zero(table.mass), count, f"{kind}.mass")
    stuck = member_numbers(table.stuck, count, f"{kind}.stuck")
    try:
        return dataclasses.replace(
            known,
            damping=damping if damping.any() else None,
            stuck=stuck,
            mass=mass if mass.any() else None,
            clusters=way.clusters,
            pulleys=way.pulleys,
            motors=tuple(Motor(**msgspec.structs.asdict(motor)) for motor in table.motors),
        )
    except InputError as error:
        raise InputError(f"{kind}: {error}") from error


def _way_of(table: StrutsTable | CablesTable, edges: Edges, nodes: np.ndarray, kind: str) -> CableRoute:
    """Where cables run. Raises `InputError` for clusters and pulleys that are none."""
    if isinstance(table, StrutsTable):
        return CableRoute(edges, (), ())
    try:
        pulleys = tuple(Pulley(**msgspec.structs.asdict(pulley)) for pulley in table.pulleys)
        way = CableRoute(edges, tuple(map(tuple, table.clusters)), pulleys)
        check_clusters(way.clusters, edges)
        check_pulleys(way)
        check_wraps(way, nodes)
    except InputError as error:
        raise InputError(f"{kind}: {error}") from error
    return way


def _given_members(table: StrutsTable | CablesTable, edges: Edges, rest: np.ndarray, kind: str) -> Members:
    """Members of the stiffness and strength in their table."""

    def each(name: str, value: float | list[float] | None) -> np.ndarray | None:
        return None if value is None else per_member(value, len(edges), f"{kind}.{name}")

    return Members(
        edges,
        each("stiffness", _stiffness(table)),
        rest,
        yield_force=each("yield_force", table.yield_force),
        bending_stiffness=each("bending_stiffness", table.bending_stiffness),
    )


def cable_laws(table: CablesTable | None, cables: Members | None) -> tuple[Law, ...]:
    """The nonlinear force laws of a [cables] table. Raises `InputError` for keys without a law."""
    if table is None or cables is None:
        return ()
    found: list[Law] = []
    try:
        if table.force is not None:
            found.append(force_table(cables, table.force.stretch, table.force.force))
        if table.largest_force is not None:
            found.append(force_limit(cables, table.largest_force))
        if table.dead_band is not None:
            found.append(dead_band(cables, table.dead_band))
        if table.damper is not None:
            found.append(cable_dampers(cables, table.damper))
        if _is_forced(table):
            found.append(commanded_pull(cables, _or_zero(table.pull), _or_zero(table.pull_slope)))
        if table.quadratic is not None or table.cubic is not None:
            _check_polynomial(table)
            found.append(polynomial_stiffness(cables, _or_zero(table.quadratic), _or_zero(table.cubic)))
    except InputError as error:
        raise InputError(f"cables: {error}") from error
    return tuple(found)


def force_keys(law: Law) -> dict[str, Any]:
    """The keys of a nonlinear force law in a [cables] table; none for other laws."""
    if type(law) is ForceTable:
        return {"force": ForceKeys(*(np.asarray(x).tolist() for x in (law.stretch, law.force)))}
    if type(law) is CommandedPull:
        factors = 1.0 if law.factors is None else law.factors
        return {"pull": one_or_all(factors * law.pull), "pull_slope": one_or_all(factors * law.slope)}
    return {key: one_or_all(getattr(law, name)) for key, name in FIELDS_OF_LAWS.get(type(law), {}).items()}


def _check_polynomial(table: CablesTable) -> None:
    """Refuse a polynomial beside what limits or replaces the linear force to which it adds."""
    for name in ("force", "largest_force"):
        if getattr(table, name) is not None:
            raise InputError(f"{name}: quadratic and cubic add to the force of the stiffness; expected no {name} too")
    if table.stiffness is None:
        raise InputError("quadratic, cubic: they multiply the stiffness, of which there is none; expected a stiffness")


def _is_forced(table: CablesTable) -> bool:
    return table.pull is not None or table.pull_slope is not None


def _stiffness(table: StrutsTable | CablesTable) -> float | list[float] | None:
    """K, N/m, from its key or the first slope of a table of forces; None: rigid."""
    if isinstance(table, StrutsTable):
        if table.stiffness is None and not table.rigid:
            raise InputError("struts.stiffness: missing; expected a stiffness (N/m) or rigid = true")
        return table.stiffness
    if table.force is None:
        if table.stiffness is None and _is_forced(table):
            return 0.0
        if table.stiffness is None:
            raise InputError(
                "cables.stiffness: missing; expected a number > 0 or a list of numbers > 0, or cables.force"
            )
        return table.stiffness
    for name in ("stiffness", "largest_force", "broken"):
        if getattr(table, name) not in (None, []):
            raise InputError(f"cables.{name}: the table cables.force has every force; expected no {name} beside it")
    try:
        return first_slope(table.force.stretch, table.force.force)
    except InputError as error:
        raise InputError(f"cables.force: {error}") from error


def touching_keys(scene: Scene) -> TouchingKeys | None:
    """The table of contact between struts. Raises `InputError` where `load_scene` would make other laws of it."""
    if (law := strut_contact(scene)) is None:
        return None
    without = without_strut_contact(scene)
    again = touching_like(without, scene).terms[len(without.terms) :]
    if not eqx.tree_equal(again, scene.terms[-len(again) :]):
        raise InputError("contact between struts: expected its laws as the last ones, and unchanged, as files have")
    pairs, at_once = list(law.between.pairs), getattr(law, "at_once", None)
    return TouchingKeys(one_or_all(np.array(radius_of_struts(scene, law.between))), pairs, at_once)


def member_numbers(chosen: list[int], count: int, where: str) -> tuple[int, ...]:
    """The chosen ones of `count` members, in ascending order."""
    if len(set(chosen)) != len(chosen) or any(k >= count for k in chosen):
        raise InputError(f"{where} = {shown(chosen)}: expected numbers from 0 to {count - 1}, none twice")
    return tuple(sorted(chosen))


def _or_zero(value: float | list[float] | None) -> float | list[float]:
    return 0.0 if value is None else value


def members_table(members: Members | None, table: Callable, kind: str, forces: dict[str, Any]) -> Any:
    """The [struts] or [cables] table of members, with further keys, such as those of their `forces`.

    Raises `InputError` for members without keys in scene files.
    """
    if members is None:
        return None
    given: dict[str, Any] = {"rest_length": one_or_all(members.rest_length), "stuck": list(members.stuck)}
    given |= _stiffness_keys(members, kind, "pull" in forces)
    for name in ("damping", "mass", "yield_force", "bending_stiffness"):
        value = getattr(members, name)
        if value is not None:
            given[name] = one_or_all(value)
    if members.clusters:
        given["clusters"] = [list(cluster) for cluster in members.clusters]
        given["pulleys"] = [PulleyKeys(**_keys(pulley)) for pulley in members.pulleys]
    given["motors"] = [MotorTable(**_keys(motor)) for motor in members.motors]
    given |= forces
    if "force" in given:
        first = first_slope(given["force"].stretch, given["force"].force)
        if not np.allclose(given.get("stiffness", 0.0), first, rtol=1e-9, atol=0):
            raise InputError(f"{kind}: stiffness is not {first:g} N/m, the first slope of their table; expected that")
        given.pop("stiffness")  # which the table says
    return table(**given)


def _stiffness_keys(members: Members, kind: str, forced: bool) -> dict[str, Any]:
    """The keys that say how stiff members are; none for cables that are all `forced` without a spring."""
    stiffness = members.stiffness
    if stiffness is None:
        if kind == "cables" or members.damping is not None:
            raise InputError(f"{kind}: rigid members go without damping, and cables are springs, in scene files")
        return {"rigid": True}
    broken = [int(k) for k in np.flatnonzero(np.asarray(stiffness) == 0)]
    if broken and kind == "struts":
        raise InputError(f"struts: stiffness of {broken} is 0; expected positive ones, as scene files do")
    if forced and len(broken) == len(members.edges):
        return {}
    if broken and members.damping is not None and np.any(np.asarray(members.damping)[broken]):
        raise InputError(f"{kind}: {broken} have dampers without springs; expected a stiffness, as scene files do")
    # which are broken the file says, and not how stiff they were
    known = one_or_all(np.where(np.asarray(stiffness) == 0, 1.0, stiffness))
    return {"broken": broken, "stiffness": known} if broken else {"stiffness": known}


def _keys(part: Motor | Pulley) -> dict[str, Any]:
    """The fields of a part, its numbers as in files."""
    arrays = (np.ndarray, jax.Array)
    return {name: np.asarray(x).tolist() if isinstance(x, arrays) else x for name, x in vars(part).items()}


def one_or_all(values: AnyArray) -> float | list[float]:
    """One number where all are equal, as in files."""
    numbers = np.asarray(values, float)
    return float(numbers.flat[0]) if numbers.size and np.all(numbers == numbers.flat[0]) else numbers.tolist()
