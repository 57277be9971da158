"""The explorer rolls out what its sliders say, compiles nothing for it, and answers nobody but its own page."""

import dataclasses
import http.client
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from browser import is_red, screenshot, start_browser, wait_for
from studies.explorer_session import session

import jaxgrity
from jaxgrity.explorer import session as module
from jaxgrity.explorer import tasks
from jaxgrity.explorer.controls import adjusted, knobs
from jaxgrity.explorer.exports import EXPORTS, upright
from jaxgrity.explorer.page import Page
from jaxgrity.explorer.server import expected, guarded_server, silent
from jaxgrity.explorer.session import OTHER, OWN, chosen_robot, watched_words
from jaxgrity.io.scene_writing import scene_toml
from jaxgrity.model.actuation import contraction
from jaxgrity.orbits.finding import period_of

DURATION = 1.5


@pytest.fixture(scope="module")
def server():
    """The page "exact", on a free port."""
    made = guarded_server("127.0.0.1", 0)
    yield made
    with silent():
        made.stop()


@pytest.fixture(scope="module")
def page(server):
    """Its first rollout is done."""
    made = Page(server, ("exact", "reference"), DURATION)
    made.start()
    settled(made)
    yield made
    made.stop()


def held(structure, axes):
    """The structure with a support at node 0."""
    return dataclasses.replace(structure, fixed=((0, axes),))


def settled(page):
    """Once the error bar of the last rollout is there."""
    wait_for(lambda: "±" in page.words and "…" not in page.words, "a rollout with its error bar")


@pytest.fixture
def compiled():
    """The names of what is compiled from now on."""
    names = []
    listen = lambda name, seconds, **_: names.append(name) if "backend_compile" in name else None  # noqa: E731
    jax.monitoring.register_event_duration_secs_listener(listen)
    yield names
    jax.monitoring.unregister_event_duration_listener(listen)


@pytest.mark.campaign
def test_knobs_where_they_are_change_nothing(exact):
    """The same motion, to rounding, as without the explorer."""
    values = {knob.name: knob.value for knob in knobs(exact)}
    before, after = (jaxgrity.simulate(scene, 1.5, frame_rate=10.0) for scene in (exact, adjusted(exact, values)))
    np.testing.assert_allclose(after.positions, before.positions, atol=1e-6)


@pytest.mark.campaign
def test_cost_of_transport_is_the_objectives():
    """From the work of all steps: between frames it came out 20 % too small, with stiff struts."""
    robot = chosen_robot("reference", OWN, "lasting", DURATION)
    gaits = jaxgrity.as_population(robot.scene.gait)
    outcomes = jaxgrity.simulate_population(robot.scene, gaits, DURATION, with_metrics=True)
    cost = jaxgrity.CostOfTransport().worth(robot.scene, outcomes, DURATION)
    assert robot.roll({}).cost_of_transport == pytest.approx(-float(cost[0]), rel=1e-3)


def test_each_knob_changes_what_it_says(reference):
    """And nothing else."""
    changed = adjusted(reference, {"friction": 0.25, "cable stiffness": 2.0, "phase of 3 (rad)": 1.5, "amplitude": 0.1})
    assert float(changed.friction.mu) == pytest.approx(0.25)
    np.testing.assert_allclose(changed.structure.cables.stiffness, 2 * reference.structure.cables.stiffness)
    np.testing.assert_allclose(changed.structure.cables.rest_length, reference.structure.cables.rest_length)
    np.testing.assert_allclose(changed.gait.phase, [*reference.gait.phase[:3], 1.5, *reference.gait.phase[4:]])
    assert np.max(changed.gait.amplitude) == pytest.approx(0.1)
    np.testing.assert_allclose(changed.gait.frequency, reference.gait.frequency)
    slack = adjusted(reference, {"prestress": 0.0}).structure
    np.testing.assert_allclose(slack.cables.rest_length, jaxgrity.edge_lengths(slack.nodes, slack.cables.edges))


def test_a_phase_moves_the_whole_wave_of_its_member(exact):
    """Overtones too, so that the sliders show the gait that a search on the page has found."""
    scene = jaxgrity.with_gait(exact, jaxgrity.load_gait("brisk"))
    assert scene.gait.overtones
    own = next(knob.value for knob in knobs(scene) if knob.name == "phase of 2 (rad)")
    moved = adjusted(scene, {"phase of 2 (rad)": own + 0.7}).gait
    early = 0.7 / (2 * np.pi * float(scene.gait.frequency[2]))
    for t in (3.0, 3.3):
        before, later = contraction(scene.gait, t), contraction(scene.gait, t + early)
        np.testing.assert_allclose(contraction(moved, t), [*before[:2], later[2], *before[3:]], atol=1e-12)


def test_knobs_reach_what_the_scene_has(exact):
    """A gait of a small robot is faster than those that the slider was made for."""
    fast = dataclasses.replace(exact.gait, frequency=np.full(6, 9.0), amplitude=np.full(6, 0.7))
    for knob in knobs(jaxgrity.with_gait(exact, fast)):
        assert knob.low <= knob.value <= knob.high, knob


def test_sliders_that_nobody_moved_show_the_scene(exact):
    """A slow gait of small strokes and hardly any prestress are between the steps of sliders; zeros can be raised."""
    cables, phase = exact.structure.cables, np.linspace(0.003, 6.282, 6)
    built = jaxgrity.edge_lengths(exact.structure.nodes, cables.edges)
    slow = dataclasses.replace(exact.gait, frequency=np.full(6, 0.0407), amplitude=np.full(6, 0.0033), phase=phase)
    structure = dataclasses.replace(exact.structure, cables=dataclasses.replace(cables, rest_length=0.9963 * built))
    scene = dataclasses.replace(exact, structure=structure, gait=slow)
    known = {knob.name: knob for knob in knobs(scene)}
    shown = adjusted(scene, {name: knob.at(knob.place) for name, knob in known.items()})
    for part in ("frequency", "amplitude", "phase"):
        np.testing.assert_array_equal(getattr(shown.gait, part), getattr(slow, part))
    np.testing.assert_allclose(shown.structure.cables.rest_length, 0.9963 * built, rtol=1e-15)
    assert known["frequency (Hz)"].low < 0.0407
    assert all(knob.place > 0 for name, knob in known.items() if not name.startswith(("phase", "incline")))

    smooth = dataclasses.replace(exact, friction=jaxgrity.ConeFriction(0.0))
    still = jaxgrity.with_gait(smooth, dataclasses.replace(exact.gait, amplitude=np.zeros(6)))
    raised = adjusted(still, {"friction": 0.4, "amplitude": 0.2})
    assert float(raised.friction.mu) == 0.4
    np.testing.assert_array_equal(raised.gait.amplitude, np.full(6, 0.2))


def test_the_incline_leads_downhill(exact):
    """Without a gait's help a robot on ice slides towards +x where the incline is positive."""
    still = {"amplitude": 0.0, "friction": 0.0}
    for angle, sign in ((10.0, 1), (-10.0, -1)):
        motion = jaxgrity.simulate(adjusted(exact, {**still, "incline (degrees)": angle}), 1.0, frame_rate=10.0)
        moved = np.diff(jaxgrity.centre_path(exact, motion)[[0, -1], 0])[0]
        # g sin(angle) (t - (1 - exp(-k t))/k)/k at 1 s, with k = c/m: the nodes are damped
        k = float(exact.node_damping[0] / exact.structure.node_mass[0])
        assert sign * moved == pytest.approx(9.81 * np.sin(np.radians(10)) * (1 - (1 - np.exp(-k)) / k) / k, rel=1e-2)


def test_what_a_scene_lacks_has_no_knob(exact):
    """No gait, no explorer; too many members, no phases."""
    names = [knob.name for knob in knobs(jaxgrity.load_scene("exact"))]
    assert "friction" in names
    with pytest.raises(jaxgrity.InputError, match=r"no \[gait\]"):
        knobs(jaxgrity.with_gait(exact, None))


@pytest.mark.campaign
def test_a_slider_compiles_nothing(page, compiled):
    """Not even the first move of each, nor its error bar."""
    for name, value in [("friction", 0.3), ("incline (degrees)", 2.0), ("prestress", 0.25), ("cable stiffness", 1.5)]:
        done, before = page.rollouts, page.rolled
        page.sliders[name].value = value
        wait_for(lambda done=done: page.rollouts > done, "a rollout")
        settled(page)
        assert page.rolled is not before
        assert page.values[name] == value
    assert not compiled


@pytest.mark.campaign
def test_a_hundred_rapid_moves_end_with_the_last(page):
    """Those that it has no time for are left out, and the last one is what it shows."""
    done = page.rollouts
    for value in np.linspace(0.2, 1.2, 100):
        page.sliders["frequency (Hz)"].value = round(float(value), 2)
    shown = lambda: float(np.max(page.rolled.scene.gait.frequency))  # noqa: E731
    wait_for(lambda: shown() == pytest.approx(1.2), "the last rollout")
    settled(page)
    assert page.rollouts - done < 100
    assert shown() == pytest.approx(1.2)


@pytest.mark.slow
def test_the_words_are_those_of_the_library(page):
    """Distance and error bar agree with `verify`."""
    scene = page.rolled.scene
    gaits = jaxgrity.as_population(scene.gait)
    found = jaxgrity.verify(scene, gaits, DURATION, options=jaxgrity.SolverOptions(dt=page.rolled.trajectory.dt))
    assert page.rolled.distance == pytest.approx(float(found.distance[0]), rel=1e-6)
    assert f"± {float(found.error_bar[0]):.2g} m" in page.words


@pytest.mark.slow
def test_the_other_contact_model_is_the_twin():
    """With the gait of the library that was asked for."""
    robot = chosen_robot("exact", OTHER, "brisk", 1.0)
    assert not robot.scene.constrained
    np.testing.assert_allclose(robot.scene.gait.phase, jaxgrity.load_gait("brisk").phase)
    assert chosen_robot("exact", OWN, OWN, 1.0).scene.constrained


@pytest.mark.slow
def test_what_the_robot_settles_on_is_said_once_it_is_left_alone(page):
    """As the library finds it, or that there is none."""
    wait_for(lambda: "orbit" in page.words, "an orbit, or none")
    found = jaxgrity.orbits.find_orbit(page.rolled.scene, 56.5 * period_of(page.rolled.scene.gait))
    assert ("settles on an orbit" in page.words) == found.settled


def test_without_a_common_period_there_is_no_orbit(exact):
    """The page says why, in a line."""
    mixed = dataclasses.replace(exact.gait, frequency=np.linspace(0.4, 0.6, 6))
    words = watched_words(jaxgrity.with_gait(exact, mixed), jaxgrity.stepping.resolve(exact, 1.0))
    assert words.startswith("orbit: frequencies [0.4, ")
    assert words.endswith("expected one that all actuators share, for an orbit")


def test_a_robot_that_stays_where_it_is_has_no_turning_and_no_cost(exact, monkeypatch):
    """Both would be rounding; a distance within its error bar is not known."""
    q, v = np.asarray(exact.structure.nodes), np.zeros((12, 3))
    means = (2.0, 1, 3e-16, 0.0, 1e-15, (3e-16, 0.0), 0.0, 0.0, np.zeros(0), 113.0)
    monkeypatch.setattr(module, "find_orbit", lambda *given, **how: jaxgrity.orbits.Orbit(*means, (q, v), 1.0))
    words = watched_words(exact, jaxgrity.stepping.resolve(exact, 1.0))
    assert words == "settles on an orbit: the robot stays where it is, seen for 113 s"
    zero, path = jax.numpy.zeros((), int), np.tile(q, (26, 1, 1))
    motion = jaxgrity.Trajectory(np.linspace(0, 1, 26), path, 0 * path, zero, zero, zero, "", None)
    monkeypatch.setattr(module, "robot_poses", lambda *given: SimpleNamespace(centre=path[:, 0]))
    rolled = module._rolled(exact, motion, jaxgrity.stepping.resolve(exact, 1.0))
    assert np.isnan(rolled.cost_of_transport)
    assert "cost of transport not known" in rolled.words(1e-12)
    assert (
        rolled._replace(distance=11.0).words(88.0).startswith("**not known: 11.00 m at this time step, with an error")
    )


def test_distances_of_small_robots_keep_their_digits():
    """Where two decimals would say that they go nowhere."""
    assert [tasks._metres(distance) for distance in (1.234, 0.0123, 4e-4, 0.0)] == [
        "1.23 m",
        "0.012 m",
        "0.00040 m",
        "0.00 m",
    ]


@pytest.mark.slow
def test_tasks_move_the_sliders_and_can_be_stopped(page, monkeypatch):
    """A search tells how far it is, and what it finds is rolled out; one that is stopped changes nothing."""
    small = jaxgrity.GAConfig(population=8, generations=3, elites=2)
    monkeypatch.setattr(tasks, "SEARCH", small)
    said, tell = [], page._tell
    monkeypatch.setattr(page.runner, "_tell", lambda words: (said.append(words), tell(words)))
    before = page.values
    page._begin(tasks.search_gait, None)
    assert page.runner.busy
    page._begin(tasks.search_gait, None)  # one at a time
    wait_for(lambda: not page.runner.busy, "the end of the search")
    assert sum("generation" in words for words in said) == 3
    assert said[-1].startswith("searched")
    moved = {name for name, value in page.values.items() if value != before[name]}
    assert len(moved) > 3
    assert all(name.startswith("phase of") for name in moved)
    wait_for(lambda: np.allclose(page.rolled.scene.gait.phase[0], page.values["phase of 0 (rad)"]), "its rollout")
    settled(page)
    before = page.values
    monkeypatch.setattr(
        page.runner, "_tell", lambda words: page.runner.stop() if "generation 1" in words else tell(words)
    )
    page._begin(tasks.search_gait, None)
    wait_for(lambda: not page.runner.busy, "the end of the search")
    assert page._task_words.content == "stopped"
    assert page.values == before


@pytest.mark.campaign
def test_polishing_ends_with_what_verifies(creeping, monkeypatch):
    """The gait's own phases, or better ones; `tell` hears each step."""
    monkeypatch.setattr(tasks, "POLISH", tasks.POLISH._replace(rollouts=32, samples=4, robots=2, final_robots=4))
    said = []
    gait = tasks.polish_gait(creeping, DURATION, said.append)
    assert said[-1].startswith("polished: ")
    assert any("step 1," in words for words in said)
    assert ("is kept" in said[-1]) != np.allclose(np.mod(gait.phase - creeping.gait.phase + 1, 6.2831853), 1)


def test_a_task_that_is_not_possible_says_so(exact):
    """In one line, in place of how far it is."""
    said = []
    runner = tasks.Runner(said.append)
    runner.start(lambda tell: tasks.search_gait(exact, 0.5, tell))
    wait_for(lambda: not runner.busy, "the end of the task")
    assert said == ["**not possible**: the gait begins after 1 s of 0.5 s; expected a longer motion"]


@pytest.mark.campaign
def test_a_long_session_does_not_grow(page):
    """As experiments/studies/explorer_session.py measures 500 rollouts of it."""
    facts = session(page, 40)
    assert facts["largest_growth"] < 0.1
    assert facts["compiled_later"] == 0


@pytest.mark.slow
def test_what_is_saved_is_what_is_shown(page, tmp_path):
    """A gait and a scene that commands take, a page, and a film."""
    made = {name: export(page.rolled, "exact") for name, export in EXPORTS.items()}
    scene = jaxgrity.parse_scene(made["scene.toml"].decode())
    np.testing.assert_allclose(scene.gait.phase, page.rolled.scene.gait.phase)
    np.testing.assert_allclose(scene.structure.cables.rest_length, page.rolled.scene.structure.cables.rest_length)
    (tmp_path / "gait.json").write_bytes(made["gait.json"])
    np.testing.assert_allclose(jaxgrity.load_gait(str(tmp_path / "gait.json")).phase, page.rolled.scene.gait.phase)
    assert b"</html>" in made["replay.html"]
    assert made["animation.gif"].startswith(b"GIF89a")


@pytest.mark.campaign
def test_a_scene_that_leans_is_saved_with_an_inclined_plane(exact):
    """It moves as the one that is shown does, seen from a frame that is turned."""
    lean = np.radians(10.0)
    up = np.array([-np.sin(lean), 0.0, np.cos(lean)])
    blown = jaxgrity.with_terms(
        exact, jaxgrity.wind([3.0, 1.0, 0.0], np.full(12, 0.05), 12), jaxgrity.Push((0,), [[9.0, 0, 0]], 0.1, 0.2)
    )
    leaning = dataclasses.replace(blown, up=up)
    assert upright(dataclasses.replace(leaning, structure=held(exact.structure, "z"))).up is not None
    saved = jaxgrity.parse_scene(scene_toml(upright(leaning)))
    assert saved.up is None
    ends = [np.asarray(jaxgrity.simulate(scene, 1.5).positions[-1]) for scene in (leaning, saved)]
    turn = np.array([[np.cos(lean), 0, np.sin(lean)], [0, 1, 0], [-np.sin(lean), 0, np.cos(lean)]])
    np.testing.assert_allclose(ends[1], ends[0] @ turn.T, atol=1e-6)
    assert np.linalg.norm(ends[0].mean(0) - exact.structure.nodes.mean(0)) > 0.1


@pytest.mark.slow
def test_no_file_is_read_because_a_page_names_it(page, tmp_path):
    """What a browser sends in place of a choice is refused; numbers beyond a slider's ends are taken as its ends."""
    path = tmp_path / "mine.toml"
    path.write_text("[structure]\nkind = 'secret'\n")
    for control in (page._scene, page._gait):
        chosen = control.value
        control._impl.value = str(path)  # as a message of a client's own sets it
        page._choose(type("Event", (), {"client": object()}))
        wait_for(lambda: "not possible" in page.words, "a refusal")
        assert "expected one of" in page.words
        assert "secret" not in page.words
        control._impl.value = chosen
        page._choose(type("Event", (), {"client": object()}))
        settled(page)
    friction = page.sliders["friction"]
    for sent, taken in ((1e9, 1.5), (-3.0, 0.0)):
        friction._impl.value = sent
        assert page.values["friction"] == taken
    friction._impl.value = 0.4


@pytest.mark.parametrize(
    ("host", "origin", "status"),
    [
        ("127.0.0.1", None, 200),
        ("localhost", None, 200),
        ("evil.example", None, 403),
        ("127.0.0.1", "http://evil.example", 403),
        ("127.0.0.1", "null", 403),
    ],
)
def test_foreign_requests_are_refused(server, host, origin, status):
    """Whoever asks for another host, or from a page of another, for the page as for the socket."""
    port = server.get_port()
    for upgrade in ({}, {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}):
        key = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Protocol": "viser-v0"} if upgrade else {}
        connection = http.client.HTTPConnection("127.0.0.1", port)
        headers = {"Host": f"{host}:{port}", **upgrade, **key} | ({} if origin is None else {"Origin": origin})
        connection.request("GET", "/", headers=headers)
        assert connection.getresponse().status == (101 if upgrade and status == 200 else status)
        connection.close()


def test_a_page_of_another_port_is_foreign():
    """Its own page alone is at home; programs without a page may ask."""
    assert expected(["127.0.0.1:8080"], ["http://127.0.0.1:8080"], ("127.0.0.1",))
    assert expected(["127.0.0.1:8080"], [], ("127.0.0.1",))
    assert not expected(["127.0.0.1:8080"], ["http://127.0.0.1:9000"], ("127.0.0.1",))
    assert not expected([], [], ("127.0.0.1",))


def move_a_slider(browser) -> None:
    """By a key; waits until the page says something else."""
    keys = pytest.importorskip("selenium.webdriver").Keys
    words = "return document.body.innerText.match(/[0-9.]+ . [^ ]+ m[^]*?cost of transport [0-9.]+/)?.[0] ?? ''"
    wait_for(lambda: browser.execute_script(words), "what the page says of its rollout")
    # of the sliders the first is that of the time, the next one changes the robot
    slider = browser.find_elements("css selector", "[role=slider]")[1]
    before = browser.execute_script(words).split("\n")[1:]
    slider.send_keys(keys.ARROW_RIGHT)
    wait_for(lambda: browser.execute_script(words).split("\n")[1:] not in ([], before), "another rollout")


@pytest.mark.campaign
def test_a_slider_in_a_browser_is_answered(server, page):
    """By a rollout for each key that moves it."""
    browser = start_browser()
    try:
        browser.get(f"http://127.0.0.1:{server.get_port()}")
        done = page.rollouts
        for _ in range(4):
            move_a_slider(browser)
        assert page.rollouts >= done + 4
    finally:
        browser.quit()


@pytest.mark.campaign
def test_two_tabs_a_reload_and_a_closed_tab(server, page):
    """A browser draws the robot, and none of them stops the page from answering."""
    browser = start_browser()
    try:
        address = f"http://127.0.0.1:{server.get_port()}"
        browser.get(address)
        wait_for(lambda: len(server.get_clients()) == 1, "the first tab")
        wait_for(lambda: is_red(screenshot(browser)).sum() > 200, "red struts")
        browser.switch_to.new_window("tab")
        browser.get(address)
        wait_for(lambda: len(server.get_clients()) == 2, "the second tab")
        before = set(server.get_clients())
        browser.refresh()
        # the old connection may outlive the reload for a while, and its number alone does not tell it from the new one
        wait_for(
            lambda: len(server.get_clients()) == 2 and set(server.get_clients()) != before, "the second tab, again"
        )
        settled(page)
        done, friction = page.rollouts, page.sliders["friction"]
        friction.value = 0.3 if friction.value > 0.35 else 0.4  # where it is already, it would not move
        browser.close()
        wait_for(lambda: len(server.get_clients()) == 1, "the first tab alone")
        wait_for(lambda: page.rollouts > done, "a rollout")
    finally:
        browser.quit()
    settled(page)
