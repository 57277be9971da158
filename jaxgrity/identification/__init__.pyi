from .fits import Estimate, Identified, identify, misfit_of, profile_likelihood
from .forecasts import SpeedForecast, speed_forecast, speed_slopes
from .measurements import MeasuredPoses, measured_poses, predicted
from .motions import MeasuredMotion, Starts, measured_motion
from .observations import SeenAngles, SeenDistances, SeenPositions, SeenQuantity, SeenTensions, SeenTogether
from .parameters import Parameter, changed
from .posterior import posterior_robots, uncertainty_of
from .recorded_motions import Compared, beside_simulation, recorded_motion
from .recordings import Recording, read_recording

__all__ = [
    "Compared",
    "Estimate",
    "Identified",
    "MeasuredMotion",
    "MeasuredPoses",
    "Parameter",
    "Recording",
    "SeenAngles",
    "SeenDistances",
    "SeenPositions",
    "SeenQuantity",
    "SeenTensions",
    "SeenTogether",
    "SpeedForecast",
    "Starts",
    "beside_simulation",
    "changed",
    "identify",
    "measured_motion",
    "measured_poses",
    "misfit_of",
    "posterior_robots",
    "predicted",
    "profile_likelihood",
    "read_recording",
    "recorded_motion",
    "speed_forecast",
    "speed_slopes",
    "uncertainty_of",
]
