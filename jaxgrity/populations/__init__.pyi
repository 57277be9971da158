from .clearance import rod_depths
from .lanes import discretise_lanes, in_lanes, lanes_last, over_lanes, roll_out_lanes
from .population import roll_out

__all__ = [
    "discretise_lanes",
    "in_lanes",
    "lanes_last",
    "over_lanes",
    "rod_depths",
    "roll_out",
    "roll_out_lanes",
]
