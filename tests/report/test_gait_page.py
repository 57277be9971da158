"""The page that a search leaves leads with what the gait does; the picture of its orbit is that of a closed path."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure

import jaxgrity
from jaxgrity.cli import compare
from jaxgrity.core.display import significant
from jaxgrity.orbits.error_bars import OrbitErrorBars
from jaxgrity.orbits.finding import Orbit
from jaxgrity.orbits.one_cycle import OrbitCycle
from jaxgrity.report import gait_report, measuring, plot
from jaxgrity.report.gait_report import leave_figures, write_page
from jaxgrity.report.gait_rows import (
    _chosen,
    _directions,
    distance_words,
    late_words,
    leading_sentences,
    outcome_rows,
    search_rows,
)
from jaxgrity.report.measuring import WATCHED
from jaxgrity.report.orbit_plot import _moving_frame
from jaxgrity.report.steady import _cycle_facts, _standing, ensemble_time
from jaxgrity.report.steady_words import steady_rows
from jaxgrity.trust.error_bars import Verified

STEADY = {
    "settled": True,
    "speed": 0.8858,
    "speed_error_bar": 0.0042,
    "body_lengths_per_second": 0.8858,
    "verified_for": 298.7,
    "settled_after": 14.8,
    "slowest_window": 0.8851,
    "turning": -1e-12,
    "turning_error_bar": 0.0035,
    "multiplier": 0.088,
    "multiplier_error_bar": 0.021,
    "returned": 1.0,
    "along_heading": None,
    "period": 1.3455,
    "periods": 2,
    "residual": 9e-14,
    "body_length": 1.0,
    "repetition": {"time": 1.3455, "nodes": [], "residual": 0.0},
    "cycle": {"supports": [[6, 9, 11], [0, 6, 9]], "cost_of_transport": 3.77},
    "robust": {
        "mean": 0.824,
        "standard_deviation": 0.14,
        "standard_error": 0.012,
        "bend": 0.0,
        "bend_quartiles": [-0.1, 0.2],
        "robots": 128,
    },
    "other_contact_model": {
        "speed": 0.813,
        "standard_deviation": 0.18,
        "standard_error": 0.016,
        "bend": None,
        "bend_quartiles": [None, None],
    },
}
ACTUATORS = {"peak_force": 275.1, "peak_rate": 0.988, "peak_power": 143.4, "cost_of_transport_by_effort": 5.41}
ACTUATORS |= {"rate_bound": 1.0, "excess": 0.0}


RANKS = ("rank_correlation", "rank_correlation_of_the_evolved")
LOST = "settle on no orbit that attracts disturbed robots, in the first half of 48 periods of actuation; the chosen one"
ADVICE = "this gait does not last; try another seed, or a longer search"


@pytest.mark.parametrize(
    ("multipliers", "told"),
    [
        ([0.1, 0.9974], "per cycle 0.1, 0.997; the chosen one has the best fitness"),
        ([np.inf, 0.2], f"per cycle 0.2; 1 of 2 {LOST} is none of these, and has the best fitness"),
        (
            [np.inf, np.inf],
            "orbit that attracts disturbed robots, in the first half of 48 periods of actuation; "
            "the chosen one has the best fitness",
        ),
    ],
)
def test_a_gait_without_an_orbit_is_not_taken_for_the_next_one(multipliers, told):
    assert _chosen([0.6, 0.5], multipliers)["finalists"].endswith(told)


@pytest.mark.parametrize(("settled_after", "shown"), [(0.5, True), (1.5, False)])
def test_a_motion_that_has_not_settled_is_not_shown_as_an_orbit(exact, monkeypatch, tmp_path, settled_after, shown):
    """The orbit is found in a longer rollout; where the shown one ends too early, all of it is shown."""
    begins, pictures = [], []
    monkeypatch.setattr(gait_report, "leave_figures", lambda found, folder: pictures.extend(found))
    monkeypatch.setattr(gait_report, "some_frames", lambda trajectory, kept: begins.append(np.argmax(kept)))
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("lasting"))
    steady = {"settled": True, "settled_after": settled_after, "period": 0.4, "periods": 2, "turning": 0.0}
    times, q = np.linspace(0, 2.0, 21), np.asarray(exact.structure.nodes)[None].repeat(21, 0)
    zero = jnp.zeros((), int)
    gait_report.draw_motion(
        scene, jaxgrity.Trajectory(times, q, 0 * q, zero, zero, zero, "", None), None, steady, tmp_path
    )
    assert ("orbit.png" in pictures) is shown
    assert begins == [12 if shown else 0]


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.5])
def test_an_orbit_is_closed_in_its_moving_frame(turn):
    """What wobbles about a circle, or a line, wobbles about the frame's origin, on the side where it does."""
    share = np.linspace(0, 1, 101)
    wobble = 0.05 * np.exp(2j * np.pi * share) + 0.02j * np.sin(4 * np.pi * share)
    wobble -= wobble.mean()
    heading = np.exp(1j * (0.3 + turn * share))
    along = 2.4 * (np.exp(0.3j) * share if turn == 0 else (heading - heading[0]) / (1j * turn))
    origin, found = _moving_frame(along + heading * wobble, turn)
    seen = (along + heading * wobble - origin) / found
    assert abs(seen[-1] - seen[0]) < 1e-12
    assert abs(seen.mean()) < 1e-12
    if turn == 0:
        np.testing.assert_allclose(found, heading, atol=1e-12)
        np.testing.assert_allclose(seen, wobble, atol=1e-3)


@pytest.mark.parametrize(("turning", "incline"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5)])
def test_the_moving_frame_goes_along_the_arc(exact, turning, incline):
    """In 4 s, on a circle too, where the way straight to its end is shorter by a sixth, and down a slope, where a robot
    that stays as high above the plane stays as high in the figure."""
    times = np.linspace(0, 4.0, 161)
    angle, zero = turning * times, 0 * times
    turn = np.array(
        [[np.cos(angle), -np.sin(angle), zero], [np.sin(angle), np.cos(angle), zero], [zero, zero, 1 + zero]]
    )
    way = 0.8 * (times if turning == 0 else np.expm1(1j * angle) / (1j * turning))
    nodes = np.einsum("abf,nb->fna", turn, np.asarray(exact.structure.nodes))
    nodes = nodes + np.stack([np.real(way), np.imag(way), zero], axis=-1)[:, None]
    tilt = np.array([[np.cos(incline), 0, np.sin(incline)], [0, 1, 0], [-np.sin(incline), 0, np.cos(incline)]])
    done = jaxgrity.Trajectory(
        times, nodes @ tilt.T, 0 * nodes, jnp.zeros((), int), jnp.zeros((), int), jnp.zeros((), int), "", None
    )
    there = replace(exact, ground=replace(exact.ground, incline=incline))
    figure = plot.orbit_figure(there, done, 4.0, turning)
    assert figure.axes[1].get_title() == "about a frame that goes at 0.800 m/s"
    height = next(line for line in figure.axes[1].lines if line.get_label() == "up").get_ydata()
    np.testing.assert_allclose(height, 0, atol=1e-9)


def test_a_cycle_must_be_within_the_motion(exact):
    """And there must be a ground whose touching nodes can be shown."""
    motion = jaxgrity.simulate(exact, 0.1)
    with pytest.raises(jaxgrity.InputError, match=r"cycle = 1 s: expected more than 0 and at most the motion's 0\.1 s"):
        plot.orbit_figure(exact, motion, 1.0)
    with pytest.raises(jaxgrity.InputError, match="no ground"):
        plot.orbit_figure(jaxgrity.Scene(exact.structure), motion, 0.05)


def test_the_rows_say_what_a_gait_is_worth():
    """Speed first, then for how long, turning, stability, both models of contact, and what actuators must give."""
    known = {"steady": STEADY, "actuators": ACTUATORS, "within_bounds": True, "beyond_bounds": 0.0, "duration": 40.0}
    known |= {"robust": {"robots": 128}}
    rows = outcome_rows(known)
    strained = outcome_rows({**known, "beyond_bounds": 0.2})["actuators need"]
    assert strained.endswith("; 20 % of perturbed robots exceed a bound on actuators")
    quick = {**known, "actuators": {**ACTUATORS, "peak_rate": 1.133}}
    in_ramp = "; the rate exceeds its bound of 1 m/s, but only in the gait's ramp"
    assert outcome_rows(quick)["actuators need"].endswith("along the path)" + in_ramp)
    assert in_ramp not in outcome_rows({**quick, "within_bounds": False})["actuators need"]
    unbounded = {**quick, "actuators": {**quick["actuators"], "rate_bound": None}}
    assert in_ramp not in outcome_rows(unbounded)["actuators need"]
    assert list(rows) == [
        "speed",
        "lasts",
        "turning",
        "stability",
        "cycle",
        "both contact models",
        "actuators need",
    ]
    assert rows["speed"] == "0.886 ± 0.004 m/s (0.886 body lengths/s)"
    assert rows["lasts"] == "watched for 299 s; settles after 15 s; slowest 10 s after that: 0.885 m/s"
    assert rows["turning"] == (
        "0.0 ± 0.2 °/s; half of the perturbed robots bend by -6° to 11° per body length, on the other contact model "
        "by no known angle"
    )
    assert rows["stability"].startswith("largest Floquet multiplier 0.09 ± 0.02 per cycle (translation")
    assert rows["stability"].endswith("over two cycles); 100 % of disturbed robots return")
    assert "(translation excluded;" in steady_rows({**STEADY, "yaw_excluded": False})["stability"]
    assert "; 2 symmetry-equivalent segments per cycle, which differ by 0 mm" in rows["cycle"]
    assert rows["cycle"].endswith("stands on the faces 6-9-11, 0-6-9 in turn")
    assert rows["both contact models"] == (
        "0.82 ± 0.02 m/s (standard deviation 0.14) over 128 perturbed robots; "
        "0.81 ± 0.03 m/s (standard deviation 0.18) on the other contact model"
    )
    assert rows["actuators need"].startswith("up to 275 N, 0.99 m/s, 143 W; cost of transport 3.8 (")
    assert rows["actuators need"].endswith("d along the path)")
    wandering = outcome_rows({**known, "steady": {**STEADY, "settled": False}})["actuators need"]
    assert wandering.endswith("cost of transport 5.4 (work of every actuator / (m g d), d from the start)")
    along = {"mean": 0.6, "standard_deviation": 0.1, "standard_error": 0.01}
    robots = {"robust": along, "other_contact_model": {**along, "standard_error": None, "failed": 2}}
    uphill = steady_rows({**STEADY, "along_heading": {"heading": 3.1, "speed": 0.67, **robots}})
    assert uphill["along its heading"] == (
        "0.670 m/s, horizontally; perturbed robots 0.60 ± 0.02 m/s (standard deviation 0.1), "
        "on the other contact model 0.600 m/s (error not known) (standard deviation 0.1; 2 robots failed)"
    )
    small = steady_rows({**STEADY, "verified_for": 8.44, "settled_after": 0.32, "period": 0.05, "periods": 1})
    assert small["lasts"].startswith("watched for 8.4 s; settles after 0.32 s")
    assert small["cycle"].startswith("0.0500 s, 1 period of actuation")
    brief = steady_rows({**STEADY, "slowest_window": None})["lasts"]  # settled for less than the first window
    assert brief == "watched for 299 s; settles after 15 s"
    one = {"standard_deviation": 0.0, "standard_error": None, "robots": 1}
    alike = steady_rows({**STEADY, "robust": {**STEADY["robust"], **one}})["both contact models"]
    assert alike.startswith("0.824 m/s over one robot, as nothing is uncertain; 0.81")
    lost = steady_rows({**STEADY, "settled": False, "residual": 0.3})
    assert lost == {
        "orbit": f"none: in the later half of 299 s the shape changes by up to 0.3 m over a cycle; {ADVICE}"
    }
    turning = steady_rows({**STEADY, "settled": False, "residual": 0.02, "turning": 0.1})
    assert turning == {"orbit": f"none: the robot turns by 5.7 °/s; on a slope or in wind no orbit turns; {ADVICE}"}
    failed = steady_rows({**STEADY, "settled": False, "residual": np.inf, "verified_for": 0.0})
    assert failed == {"orbit": f"none: the rollout failed; {ADVICE}"}


def test_what_is_measured_before_the_orbit_is_not_told_as_on_it():
    """Loads in the search's duration, and speeds of robots within a minute: an orbit may be reached later."""
    early = steady_rows({**STEADY, "robust": {**STEADY["robust"], "counted_from": 14.0}})["both contact models"]
    assert "over 128 perturbed robots from 14 s on, before the gait settles; 0.81" in early  # it settles after 14.8 s
    known = {"actuators": ACTUATORS, "within_bounds": True, "beyond_bounds": 0.0, "duration": 40.0}
    rows = outcome_rows({**known, "steady": {**STEADY, "settled_after": 39.0}})
    asked = "up to 275 N, 0.99 m/s, 143 W in the first 40 s, before a whole cycle of the orbit; cost"
    assert rows["actuators need"].startswith(asked)
    # and the page has no picture of it
    assert rows["picture of the orbit"] == "none: the motion ends after 40 s, the first whole cycle after 41.7 s"
    assert "picture of the orbit" not in outcome_rows({**known, "steady": STEADY})


def test_the_rows_say_who_is_beyond_a_bound():
    """The gait itself, by how much, and which share of perturbed robots."""
    known = {"steady": STEADY, "actuators": ACTUATORS, "within_bounds": True, "beyond_bounds": 0.0, "duration": 40.0}
    known |= {"robust": {"robots": 128}}
    lost = {**known, "within_bounds": False, "beyond_bounds": 1.0, "actuators": {**ACTUATORS, "excess": 0.1234}}
    told = outcome_rows(lost)["actuators need"]
    assert told.endswith(
        "; this exceeds its bounds by 12 %, added up over them; 100 % of perturbed robots exceed a bound on actuators"
    )
    strong = {**lost, "actuators": {"peak_force": 1234.0, "peak_rate": 123.4, "peak_power": 99990.0, "excess": 2.345}}
    strong["actuators"] |= {"cost_of_transport_by_effort": 123.4, "rate_bound": 1.0}
    told = outcome_rows({**strong, "steady": {**STEADY, "settled": False}})["actuators need"]
    assert told.startswith("up to 1230 N, 120 m/s, 100000 W; cost of transport 120 (")
    assert "exceeds its bounds by 230 %" in told
    assert compare.COLUMNS["peak N, m/s, W"](strong) == "1230, 120, 100000"
    alone = outcome_rows({**lost, "robust": {"robots": 1}})["actuators need"]
    assert alone.endswith("; this exceeds its bounds by 12 %, added up over them")
    assert compare.COLUMNS["beyond a bound"](lost) == "itself, and 100 % of robots"
    assert compare.COLUMNS["beyond a bound"](known) == "0 % of robots"


def test_seconds_of_a_resumed_search_are_those_since_then():
    told = [compare.COLUMNS["seconds"]({"wall_seconds": 61.4, "settings": {"resume": each}}) for each in (False, True)]
    assert told == ["61", "61 since resumed"]


def test_the_row_of_the_objective_says_that_a_gait_is_late():
    """Where steady objectives count time before full swing; a quick search of 8 s, with starts as usual, does not."""
    robots = {**STEADY["robust"], "step_error": 1e-3}
    known = {"steady": None, "robust": robots, "other_contact_model": robots, "directions": []}
    known |= {"searches": [{"rollouts": 64, "best": [0.5, 0.824], "within": [0, 7]}]}
    known |= {
        "fidelity": {"levels": [{"name": "screening"}, {"name": "both models"}], **{name: [[1.0]] for name in RANKS}},
        "polish": None,
    }
    known |= {"finalists": {"fitness": [1.0], "multipliers": None}, "diagnosis": {}, "ramp": 1.0}
    row = lambda objective, **when: search_rows({**known, **when}, None, objective)["objective"]  # noqa: E731
    late = row(jaxgrity.SteadySpeed(), start=10.0, duration=20.0)
    assert late.endswith(
        "on the other contact model; it counts the time from 5 s on, but the gait is in full swing from 11 s on: "
        "search with a duration of 44 s or more"
    )
    assert row(jaxgrity.SteadySpeed(), start=1.0, duration=8.0).endswith("on the other contact model")
    assert row(jaxgrity.Distance(), start=10.0, duration=20.0).endswith("on the other contact model")


@pytest.mark.parametrize("swing", [11.0, 1.0 + 7 / 3, 0.012344, 2.5099, 249.9])
def test_the_duration_that_is_said_to_be_enough_is(swing):
    """With it, the gait is in full swing in time; it is no longer than three digits make it."""
    told = late_words(swing, swing)
    enough = float(told.split("a duration of ")[1].split()[0])
    assert 4 * swing * (1 - 1e-12) <= enough <= 4.05 * swing
    assert not late_words(swing, enough)


def test_searches_by_objectives_of_ones_own_are_compared():
    """Their record has the unit, as another program does not know the objective."""
    robots = {"robust": {"mean": 0.5, "standard_deviation": 0.0, "standard_error": None}}
    assert compare.COLUMNS["robust"]({**robots, "objective": "of my own", "unit": "kg"}) == "0.500 kg"


def test_gaits_beyond_bounds_are_not_compared_as_if_they_were_within():
    """Where no gait of a generation keeps the bounds, the comparison of searches has a gap."""
    robots = {"mean": 0.5, "standard_deviation": 0.1}
    searches = [{"best": [5.0, 0.3], "within": [0, 2]}, {"best": [0.4, None], "within": [8, 0]}]
    run = {"searches": searches, "robust": robots, "other_contact_model": robots}
    (line,) = compare.figure({"a": run}).axes[0].lines
    np.testing.assert_array_equal(line.get_ydata(), [np.nan, 0.3, 0.4, np.nan])


def test_the_rows_say_how_sure_each_direction_is():
    """A heading where the error bar is shorter than the way; what was not measured is not known."""
    way = {"distance": 1.7512, "error_bar": 0.003, "heading": 2.0944}
    lost = {"distance": 1.5, "error_bar": 11.0, "heading": 0.0}
    robots = {"mean": 0.6, "standard_deviation": 0.0, "standard_error": None, "robots": 1, "step_error": 2.5e-3}
    known = {"steady": None, "robust": robots, "other_contact_model": robots}
    known |= {"directions": [way, {**way, "heading": -1e-3}, lost]}
    known |= {"searches": [{"rollouts": 64, "best": [0.5, 0.824], "within": [0, 7]}]}
    known |= {
        "fidelity": {"levels": [{"name": "screening"}, {"name": "both models"}], **{name: [[1.0]] for name in RANKS}},
        "polish": None,
    }
    known |= {"finalists": {"fitness": [0.732], "multipliers": None}, "diagnosis": {}, "start": 1.0, "ramp": 1.0}
    known |= {"distance": 1.75, "error_bar": 0.003, "duration": 8.0}
    rows = search_rows(known, None, jaxgrity.Distance())
    assert rows["directions"] == (
        "1.751 ± 0.003 m towards 120° (0° is along x, 90° along y). The robot is symmetric: with its actuators "
        "relabelled by that symmetry, the same gait goes 1.751 ± 0.003 m towards 0°, or a way that is not known "
        "(2 ± 10 m)"
    )
    alone = search_rows({**known, "directions": [way]}, None, jaxgrity.Distance())["directions"]
    assert alone == "1.751 ± 0.003 m towards 120° (0° is along x, 90° along y)"
    assert rows["sensitivity at the end"] == "not known"
    assert rows["search"].startswith("64 rollouts of the evolution; ")
    assert rows["fitness"] == (
        "0.824 m, best of the last generation (screening), by the draws that chose it; 0.732 m, the chosen finalist, "
        "by fresh ones that compare finalists (both models)"
    )
    strained = {**known, "searches": [{"rollouts": 64, "best": [0.5, 0.824], "within": [7, 0]}]}
    told = search_rows(strained, None, jaxgrity.Straightness())["fitness"]
    assert told.startswith("0.824, best of the last generation (screening), of gaits beyond their bounds, by the draws")
    assert "; 0.600 m on the other" in rows["objective"]
    assert "differs by 0.0025 m between two time steps, one half of the other;" in rows["objective"]
    fewer = {**known, "robust": {**robots, "robots": 256}, "other_contact_model": {**robots, "robots": 128}}
    told = search_rows(fewer, None, jaxgrity.Distance())["objective"]
    assert told.startswith("0.600 m over 256 perturbed robots, ")
    assert told.endswith("; 0.600 m over 128 perturbed robots on the other contact model")
    fallen = {**known, "robust": {**robots, "step_error": np.nan}}
    told = search_rows(fallen, None, jaxgrity.Distance())["objective"]
    assert "differs by an unknown amount between two time steps" in told


def test_sentences_say_what_to_know_first():
    """How fast and straight, how sure, what actuators must give; without an orbit how far, or that there is none."""
    needs = "An actuator needs up to 275 N, 0.99 m/s and 143 W, the start included."
    known = {"steady": {**STEADY, "body_length": 1.0, "turning": -0.1}, "actuators": ACTUATORS}
    sure = leading_sentences({**known, "steady": {**STEADY, "turning": -1e-3}})[0]
    assert sure.endswith("turns by 0.1 ± 0.2° per body length.")  # to a side that is not known
    assert leading_sentences(known) == (
        "The robot moves at 0.886 ± 0.004 body lengths per second and turns by 6.5 ± 0.2° per body length to the "
        "right.",
        "The speed of 128 perturbed robots is 0.82 ± 0.02 body lengths per second (standard deviation 0.14), and on "
        "the other contact model 0.81 ± 0.03 body lengths per second (standard deviation 0.18).",
        needs,
    )
    half = leading_sentences({**known, "steady": {**known["steady"], "body_length": 0.5}})[1]
    assert half.startswith("The speed of 128 perturbed robots is 1.65 ± 0.05 body lengths per second (standard dev")
    on_the_spot = {**known["steady"], "body_lengths_per_second": 0.0, "speed_error_bar": 1e-4, "turning": -0.5}
    told = "The robot stays where it is and turns by 28.6 ± 0.2° per second to the right."
    assert leading_sentences({**known, "steady": {**on_the_spot, "stays": True, "turns": True}})[0] == told
    unsure = leading_sentences({**known, "steady": {**on_the_spot, "speed": 0.3, "speed_error_bar": 0.4}})[0]
    assert unsure.startswith(
        "Whether the robot moves is not known: its speed is 0.0 ± 0.4 body lengths per second; take"
    )
    lost = {**known, "steady": {**STEADY, "settled": False}}
    assert leading_sentences(lost) == (f"The robot settles on no orbit: {ADVICE}.", needs)
    short = {"steady": None, "actuators": ACTUATORS, "distance": 2.0, "error_bar": 0.01, "duration": 8.0}
    assert leading_sentences(short) == ("The robot goes 2.00 ± 0.01 m in 8 s.", needs)


STANDS = {"mean": 2e-16, "speed": 2e-16, "standard_deviation": 1e-16, "standard_error": 1e-17, "robots": 128}
STANDS |= {"failed": 0, "stay": 128, "bend": None, "bend_quartiles": [None, None]}


def test_a_robot_that_stays_where_it_is_is_said_to():
    """First of all; nothing is said of turns, bends, headings and transport, which would be rounding."""
    still = {**STEADY, "speed": 2.86e-16, "speed_error_bar": 8e-16, "body_lengths_per_second": 2.86e-16, "stays": True}
    still |= {"turns": False, "robust": STANDS, "other_contact_model": STANDS, "slowest_window": 1e-16}
    still |= {"cycle": {**STEADY["cycle"], "cost_of_transport": None}, "along_heading": {"heading": 0.0}}
    asked = {**ACTUATORS, "cost_of_transport_by_effort": None}
    known = {"steady": still, "actuators": asked, "within_bounds": True, "beyond_bounds": 0.0, "duration": 40.0}
    first, robots, _ = leading_sentences(known)
    assert first == "The robot stays where it is."
    stay = "0 body lengths per second (128 robots stay where they are)"
    assert robots == f"The speed of 128 perturbed robots is {stay}, and on the other contact model {stay}."
    rows = outcome_rows(known)
    assert list(rows) == ["speed", "lasts", "stability", "cycle", "both contact models", "actuators need"]
    assert rows["speed"] == "0: the robot stays where it is"
    assert rows["lasts"] == "watched for 299 s; settles after 15 s"
    assert rows["actuators need"] == "up to 275 N, 0.99 m/s, 143 W"
    on_the_spot = {**still, "turns": True, "turning": 0.5}
    assert steady_rows(on_the_spot)["turning"] == "28.6 ± 0.2 °/s, on the spot"
    short = {**known, "steady": None, "stays": True, "distance": 3e-16, "error_bar": 1e-15}
    assert leading_sentences(short)[0] == "The robot stays where it is."
    said = "less than a hundredth of a body length: the robot stays where it is"
    assert outcome_rows(short)["verified distance"] == said
    assert "transport" not in outcome_rows(short)["actuators need"]
    assert _directions([{"distance": 3e-16, "error_bar": 1e-17, "heading": None}]) == {}
    lost = {**short, "stays": False, "distance": 11.0, "error_bar": 88.0}
    assert leading_sentences(lost)[0].startswith(
        "How far the robot goes is not known: 11.00 m at this time step, with an"
    )


def test_bends_are_those_of_robots_that_move():
    """Where others stay where they are; where the speed is not known, none are told."""
    some = {**STEADY, "robust": {**STEADY["robust"], "stay": 5}}
    assert "; half of the perturbed robots that move bend by -6° to 11°" in steady_rows(some)["turning"]
    assert "(standard deviation 0.14; 5 robots stay where they are)" in steady_rows(some)["both contact models"]
    lost = steady_rows({**STEADY, "speed_error_bar": 2.0})
    assert lost["speed"].startswith("not known: 0.89 m/s at this time step, with an error bar of 2 m/s; take a smaller")
    assert "turning" not in lost


@pytest.mark.parametrize(
    ("speed", "bar", "turning", "off", "found"),
    [
        (2e-16, 8e-16, 1e-15, 1e-16, (True, False)),
        (9e-4, 1e-6, 0.5, 0.1, (True, True)),
        (9e-4, 1e-6, 0.5, 0.6, (True, False)),
        (9e-4, 0.5, 0.0, 0.0, (False, False)),
        (9e-4, np.inf, 0.5, np.inf, (False, True)),
        (0.1, 1e-3, 1e-4, 1e-9, (False, False)),
    ],
)
def test_a_robot_stays_where_it_is_by_the_scale_of_its_body(exact, speed, bar, turning, off, found):
    """Slower than a thousandth of a body length of 1 m in a second, with the error bar; it has no cost of transport."""
    means = (1.0, 1, speed, 0.0, turning, (speed, 0.0), 0.0, 0.0, np.zeros(0), 60.0)
    state = np.asarray(exact.structure.nodes), np.zeros((12, 3))
    orbit, bars = Orbit(*means, state, 1.0), OrbitErrorBars(bar, off, 0.0, {"cost_of_transport": 1e9})
    assert tuple(_standing(exact, orbit, bars).values()) == found
    cycle = OrbitCycle(1.0, speed, 1.0, 1.0, 7.7e15, 1.0, 1.0, 1.0, ())
    facts = _cycle_facts(exact, orbit, cycle, bars)
    costs = facts["cost_of_transport"], facts["error_bars"]["cost_of_transport"]
    assert costs == ((None, None) if speed < 1e-3 else (7.7e15, 1e9))


@pytest.mark.parametrize(("distance", "stays"), [(3e-16, True), (0.5, False)])
def test_a_robot_that_stays_has_no_heading_and_no_cost_of_transport(exact, monkeypatch, distance, stays):
    """In the files of a search either: rounding would give both."""
    ends = np.array([[distance, 0.0, 0.0]])
    verified = Verified(ends[:, 0], ends[:, 0] / 9, 0 * ends, ends, (1e-3,) * 3)
    monkeypatch.setattr(measuring, "verify", lambda *given, **how: verified)
    headings = [each["heading"] for each in measuring.directions(exact, jaxgrity.SolverOptions(), 8.0)]
    assert headings == ([None] if stays else [0.0]) * len(headings)
    assert measuring.verified_stays(exact, verified, 8.0) is stays
    weight = float(exact.structure.mass * exact.gravity)
    cost = measuring.cost_of_way(exact, 3.0, distance, 8.0)
    assert cost is None if stays else cost == pytest.approx(3.0 / weight / distance)


def test_a_long_cycle_lists_a_few_faces():
    faces = [[k, k + 1, k + 2] for k in range(48)]
    told = steady_rows({**STEADY, "cycle": {**STEADY["cycle"], "supports": faces}})["cycle"]
    assert told.endswith(
        "stands on the faces 0-1-2, 1-2-3, 2-3-4, 3-4-5, 4-5-6, 5-6-7, 6-7-8, 7-8-9 and 40 more in turn"
    )
    told = steady_rows({**STEADY, "cycle": {**STEADY["cycle"], "supports": faces[:8]}})["cycle"]
    assert told.endswith(", 7-8-9 in turn")


def test_the_page_leads_with_them(tmp_path):
    """Then the table, the replay, in place of the animation, and the orbit; the search and its figures come after."""
    for name in ("replay.html", "animation.gif", "orbit.png", "gait.png"):
        (tmp_path / name).touch()
    write_page(tmp_path, "A gait", ("It rolls.", "5 < 6 W."), {"speed": "1 < 2 m/s"}, {"search": "many"})
    page = (tmp_path / "index.html").read_text()
    parts = ["<p>It rolls. 5 &lt; 6 W.</p>", "1 &lt; 2 m/s", "<iframe", "orbit.png", "<h2>", "many", "gait.png"]
    places = [page.index(part) for part in parts]
    assert places == sorted(places)
    assert "animation.gif" not in page
    (tmp_path / "replay.html").unlink()
    write_page(tmp_path, "A gait", (), {}, {})
    assert "animation.gif" in (tmp_path / "index.html").read_text()


def test_a_figure_that_fails_costs_this_figure(tmp_path, capsys):
    """With a line, and without that of an earlier search; the others are there."""

    def broken():
        raise ValueError("no such colour\nand more")

    (tmp_path / "gait.png").write_text("of an earlier search")
    leave_figures({"gait.png": broken, "forces.png": Figure}, tmp_path)
    assert capsys.readouterr().out.splitlines() == ["no gait.png: ValueError: no such colour"]
    assert [file.name for file in tmp_path.iterdir()] == ["forces.png"]


@pytest.mark.parametrize("size", [0.05, 0.01])
def test_a_small_robot_has_as_many_digits(size):
    """Speeds scale with lengths here, and none is printed as nothing."""
    lengths = ("speed", "speed_error_bar", "slowest_window")
    small = {**STEADY, **{name: size * STEADY[name] for name in lengths}}
    for name, mean in (("robust", "mean"), ("other_contact_model", "speed")):
        scaled = (mean, "standard_deviation", "standard_error")
        small[name] = {**STEADY[name], **{each: size * STEADY[name][each] for each in scaled}}
    along = {"mean": 0.8 * size, "standard_deviation": 0.1 * size, "standard_error": None}
    small["along_heading"] = {"speed": 0.81 * size, "robust": along, "other_contact_model": along}
    rows = steady_rows(small)
    told = {
        0.05: ("0.0443 ± 0.0002", "0.0443", "0.0405", "0.041 ± 0.001"),
        0.01: ("0.00886 ± 4e-05", "0.00885", "0.00810", "0.0082 ± 0.0002"),
    }
    speed, slowest, headed, robots = told[size]
    assert rows["speed"] == f"{speed} m/s (0.886 body lengths/s)"
    assert rows["lasts"].endswith(f"after that: {slowest} m/s")
    assert rows["along its heading"].startswith(
        f"{headed} m/s, horizontally; perturbed robots {significant(0.8 * size)} m/s ("
    )
    assert rows["both contact models"].startswith(f"{robots} m/s (standard deviation {0.14 * size:.2g})")
    found = {"distance": 0.5 * size, "error_bar": size, "duration": 8.0}
    assert distance_words(found).startswith(
        f"not known: {significant(0.5 * size, 2, 2)} m at this time step, with an er"
    )
    assert compare.COLUMNS["steady, m/s"]({"steady": small}) == speed
    compared = compare.COLUMNS["other model"]({"other_contact_model": along, "unit": "m"})
    assert compared.startswith(f"{significant(0.8 * size)} m (")
    assert significant(0.8 * size) == {0.05: "0.0400", 0.01: "0.00800"}[size]


def test_numbers_keep_their_decimals_where_those_are_enough():
    for value, words in (
        (0.5264, "0.526"),
        (12.3456, "12.346"),
        (0.0, "0.000"),
        (-0.00526, "-0.00526"),
        (3e-9, "3.00e-09"),
    ):
        assert significant(value) == words


def test_perturbed_robots_roll_for_a_minute_but_not_after_quick_searches():
    """There the ensembles of the report would take as long as the search."""
    assert ensemble_time(WATCHED * jaxgrity.SearchConfig().duration) == 60.0
    assert ensemble_time(1000.0) == 60.0
    assert ensemble_time(WATCHED * 16.0) == pytest.approx(24.0)
