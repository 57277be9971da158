"""What a study needs of `../measurements`, whose modules can be imported from here on."""

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1] / "measurements"))

from measurement import Figure, Record, check_names, measurement

__all__ = ["Figure", "Record", "check_names", "measurement"]
