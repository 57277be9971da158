"""How fast a gait will roll: slopes against orbits found anew, variances against robots, what is refused."""

import jax
import numpy as np
import pytest
from small_scenes import swept

from jaxgrity import InputError, with_gait
from jaxgrity.identification import Identified, Parameter, changed, speed_forecast, speed_slopes
from jaxgrity.identification.forecasts import steady_speeds
from jaxgrity.orbits import find_orbit

PARAMETERS = (Parameter("friction.mu", 0.2), Parameter("structure.node_mass", 0.1, parts=(1,)))
CORRELATED = 1e-2 * np.array([[1.0, 0.6], [0.6, 2.0]])


def known(scene, covariance=CORRELATED) -> Identified:
    """As if `identify` had found this scene."""
    return Identified(scene, (), PARAMETERS, np.zeros(2), covariance, (), 1.0, True, 1)


@pytest.fixture(scope="module")
def forecast(crawler):
    scene, _, options = crawler
    stages = []
    given = {"robots": 64, "duration": 60.0, "options": options}
    found = speed_forecast(jax.random.key(0), known(scene), **given, on_progress=lambda *stage: stages.append(stage))
    assert stages == [(0, 3), (1, 3), (2, 3), (3, 3)]
    return found


@pytest.mark.parametrize("angle", [0.0, 0.4, -1.5])
def test_the_speed_of_what_turns_is_about_its_centre(angle):
    """The same whatever the moment at which cycles begin, of a robot that sways as it goes round, or straight on."""
    moments = (np.arange(4 * 24 + 1) + np.arange(24)[:, None]) / 24
    sway = 0.1 * np.exp(2j * np.pi * moments) + 0.05j * np.sin(4 * np.pi * moments)
    turned = np.exp(1j * angle * moments)
    places = (turned / (1j * angle) if angle else moments) + turned * sway
    speeds = steady_speeds(np.stack([places.real, places.imag], 2), 24, 2.0)
    np.testing.assert_allclose(speeds, 0.5, rtol=1e-3)


@pytest.mark.campaign
def test_slopes_are_those_of_orbits_found_anew(crawler):
    """By central differences of long rollouts."""
    scene, orbit, options = crawler
    slopes, h = speed_slopes(scene, PARAMETERS, orbit, options=options), 0.05
    for k in range(2):
        ends = [find_orbit(changed(scene, PARAMETERS, sign * h * np.eye(2)[k]), 60.0, options=options).speed
                for sign in (1, -1)]  # fmt: skip
        np.testing.assert_allclose((ends[0] - ends[1]) / (2 * h), slopes[k], atol=0.02 * np.abs(slopes).max())


@pytest.mark.campaign
def test_the_gradient_and_the_robots_agree_on_a_small_spread(forecast):
    """On the deviation within what 64 robots tell, and on the shares."""
    s, C = forecast.slopes, CORRELATED
    np.testing.assert_allclose(forecast.gradient_deviation, np.sqrt(s @ C @ s))
    np.testing.assert_allclose(forecast.standard_deviation, forecast.gradient_deviation, rtol=0.25)
    np.testing.assert_allclose(forecast.shares, forecast.gradient_shares, atol=0.15)
    np.testing.assert_allclose(forecast.mean, forecast.orbit.speed, atol=3 * forecast.gradient_deviation)
    assert forecast.explained > 0.9
    assert forecast.rolling == 1


@pytest.mark.campaign
def test_a_share_is_what_goes_when_the_parameter_becomes_known(forecast):
    """s'Cs less s'(C without k)s, for the conditional covariance given z_k."""
    s, C = forecast.slopes, CORRELATED
    for k, share in enumerate(forecast.gradient_shares):
        given = C - np.outer(C[:, k], C[k]) / C[k, k]
        np.testing.assert_allclose(share, 1 - s @ given @ s / (s @ C @ s))


@pytest.mark.slow
def test_the_summary_names_the_most_useful_first(forecast):
    lines = forecast.summary().splitlines()
    best = PARAMETERS[int(np.argmax(forecast.gradient_shares))]
    assert "over 64 robots, of which 100% roll" in lines[0]
    assert lines[1].startswith(f"{best.name}, known exactly: variance of the speed down by ")


def test_what_has_no_forecast_is_refused(creeping):
    """Too few robots, no gait, and parameters in which robots cannot differ."""
    scene, key = creeping, jax.random.key(0)
    with pytest.raises(InputError, match=r"^robots = 4: expected at least 5"):
        speed_forecast(key, known(scene), robots=4)
    with pytest.raises(InputError, match=r"the scene has no gait, and so no orbit"):
        speed_forecast(key, known(with_gait(scene, None)))
    with pytest.raises(InputError, match=r"^ground.stiffness: robots of a population cannot differ in it"):
        speed_forecast(key, known(scene)._replace(parameters=(Parameter("ground.stiffness", 0.1), PARAMETERS[0])))
    longer = known(swept())._replace(parameters=(Parameter("structure.struts.rest_length", 0.1), PARAMETERS[0]))
    with pytest.raises(InputError, match=r"^structure.struts.rest_length: rigid struts of other lengths"):
        speed_forecast(key, longer)
