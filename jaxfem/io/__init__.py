"""Files in and out: scenes in TOML, frames for ParaView, tables and plots."""

from .examples import beam_scene
from .export import FrameWriter
from .plots import PlotError, plot_energies, plot_series, plot_shapes
from .reading import Frame, read_frames
from .scene_files import SceneFile, SceneFileError, load_scene

__all__ = [
    "Frame",
    "FrameWriter",
    "PlotError",
    "SceneFile",
    "SceneFileError",
    "beam_scene",
    "load_scene",
    "plot_energies",
    "plot_series",
    "plot_shapes",
    "read_frames",
]
