"""A film of a flight of the plant ``mujoco``, drawn by MuJoCo without a screen."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from quad_mpc_ros.configuration import UserError
from quad_mpc_ros.control.lie import Array
from quad_mpc_ros.extras.plants.mujoco.installation import film_writer, mujoco_module
from quad_mpc_ros.extras.plants.mujoco.model import VEHICLE
from quad_mpc_ros.extras.plants.mujoco.scene import Scene

FRAMES_PER_SECOND = 25
_WIDTH, _HEIGHT = 640, 480
_PERIOD_NS = 1_000_000_000 // FRAMES_PER_SECOND
_FROM, _ABOVE = 115.0, -14.0  # degrees: azimuth and elevation of the view
_DISTANCE = 1.5  # m
_EMPTY = "<mujoco><worldbody/></mujoco>"


class Camera:
    """Draws a scene, looking at the vehicle from a distance."""

    def __init__(self, scene: Scene) -> None:
        """Raise :class:`UserError` where MuJoCo cannot draw."""
        mujoco = mujoco_module()
        self._scene = scene
        self._renderer = _renderer(scene.model)
        self._view: Any = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self._view.trackbodyid = scene.model.body(VEHICLE).id
        self._view.distance = _DISTANCE
        self._view.azimuth, self._view.elevation = _FROM, _ABOVE

    def picture(self) -> Array:
        """Return what it sees now, red, green and blue from 0 to 255 (height, width, 3)."""
        self._renderer.update_scene(self._scene.data, self._view)
        picture: Array = self._renderer.render()
        return picture

    def close(self) -> None:
        """Give the graphics back."""
        self._renderer.close()


class Film:
    """Writes a film of a scene, :data:`FRAMES_PER_SECOND` of simulated time."""

    def __init__(self, scene: Scene, path: Path) -> None:
        """Begin a film; raises :class:`UserError` where none can be drawn or written."""
        self._camera = Camera(scene)
        self._writer = film_writer().get_writer(path, fps=FRAMES_PER_SECOND)
        self._next_ns = 0

    def see(self, time_ns: int) -> None:
        """Add the frames that are due by this time from the start of the flight."""
        while time_ns >= self._next_ns:
            self._writer.append_data(self._camera.picture())
            self._next_ns += _PERIOD_NS

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.close()
        self._camera.close()


def check_drawing() -> None:
    """Raise :class:`UserError` where no film can be drawn or written."""
    film_writer()
    _renderer(mujoco_module().MjModel.from_xml_string(_EMPTY)).close()


def _renderer(model: Any) -> Any:
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in screens):
        raise UserError(
            "--video: there is no screen; without one MuJoCo draws by EGL or OSMesa: "
            "set MUJOCO_GL=egl or MUJOCO_GL=osmesa"
        )
    try:
        return mujoco_module().Renderer(model, height=_HEIGHT, width=_WIDTH)
    except Exception as error:  # each of the graphics libraries fails in its own way
        raise UserError(
            f"--video: MuJoCo cannot draw here ({' '.join(str(error).split())}); "
            "try MUJOCO_GL=egl or MUJOCO_GL=osmesa"
        ) from error
