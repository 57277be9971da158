from .conversion import FORMATS, Format, read_any, write_any
from .engine_scenes import read_engine
from .foreign import Imported
from .matlab import read_matlab, save_matlab
from .meshes import save_mesh
from .mjcf_plan import mjcf_controls
from .mjcf_reading import read_mjcf
from .mjcf_writing import MuJoCoModel, mujoco_model, save_mjcf
from .ntrt import read_ntrt
from .ntrt_writing import save_ntrt
from .spreadsheets import read_tables, save_tables
from .trajectories import load_trajectory, save_trajectory
from .urdf import save_urdf

__all__ = [
    "FORMATS",
    "Format",
    "Imported",
    "MuJoCoModel",
    "load_trajectory",
    "mjcf_controls",
    "mujoco_model",
    "read_any",
    "read_engine",
    "read_matlab",
    "read_mjcf",
    "read_ntrt",
    "read_tables",
    "save_matlab",
    "save_mesh",
    "save_mjcf",
    "save_ntrt",
    "save_tables",
    "save_trajectory",
    "save_urdf",
    "write_any",
]
