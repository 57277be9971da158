from .fits import Estimate, Identified, identify, misfit_of, profile_likelihood
from .forecasts import SpeedForecast, speed_forecast, speed_slopes
from .measurements import MeasuredPoses, measured_poses, predicted
from .motions import MeasuredMotion, Starts, measured_motion
from .observations import SeenAngles, SeenDistances, SeenPositions, SeenQuantity, SeenTensions, SeenTogether
from .parameters import Parameter, changed
from .posterior import posterior_robots, uncertainty_of

__all__ = [
    "Estimate",
    "Identified",
    "MeasuredMotion",
    "MeasuredPoses",
    "Parameter",
    "SeenAngles",
    "SeenDistances",
    "SeenPositions",
    "SeenQuantity",
    "SeenTensions",
    "SeenTogether",
    "SpeedForecast",
    "Starts",
    "changed",
    "identify",
    "measured_motion",
    "measured_poses",
    "misfit_of",
    "posterior_robots",
    "predicted",
    "profile_likelihood",
    "speed_forecast",
    "speed_slopes",
    "uncertainty_of",
]
