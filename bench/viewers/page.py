"""The page of ``bgs-bench view``: a run's map, cameras and images in the browser, by viser."""

from __future__ import annotations

import html
import threading
import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from bench.errors import BenchError
from bench.evaluation.saved_run import SavedRunFolder
from bench.figures.depth_colors import colored, depth_scale, limit_of
from bench.geometry.se3 import rotation_to_quaternion
from bench.saved_map import map_file
from bench.types import Float, Image
from bench.viewers.splats import read_splats

_PIECES = 32
"""The map is sent in at most so many pieces, each with the Gaussians of some keyframes: an earlier map is shown by
hiding the later ones, and nothing is sent again."""
_MOST_FRUSTA = 300
_NEAR_M, _FAR_M = 0.05, 2000.0
_COLORS = {True: (234, 67, 53), False: (66, 133, 244)}
"""Of the frusta of keyframes, and of other frames."""
_FRAMES_PER_S = 10.0


class Page:
    """A running server, which listens at ``url`` until ``stop``. Raises ``BenchError`` for a run without map or frames.

    ``notes`` says how many Gaussians are shown, and what of the map is not shown as it is.
    """

    def __init__(self, saved: SavedRunFolder, host: str, port: int, most: int) -> None:
        import rich
        import viser  # an extra

        self._saved, self._trajectory = saved, saved.trajectory
        if not len(self._trajectory):
            raise BenchError(f"{saved.path} has no tracked frame to look from.")
        self._mapped = np.isin(self._trajectory.numbers, saved.frames.loc[saved.frames["mapped"], "number"])
        self._splats = read_splats(map_file(saved), most)
        self.notes = list(self._about_map())
        camera = saved.dataset.camera
        self._fov, self._aspect = 2 * float(np.arctan(camera.height / 2 / camera.fy)), camera.width / camera.height
        shown = self._trajectory.numbers[[0, len(self._trajectory) // 2, -1]].tolist()
        depths = [depth for number in shown if (depth := saved.depth("left", number)) is not None]
        self._max_depth_m = limit_of([], depths) or 1.0
        rich.get_console().quiet = True  # viser tells where it listens, in a table of its own
        self.server: Any = viser.ViserServer(host=host, port=port, label=f"bgs-bench {saved.path.name}", verbose=False)
        self._set_scene()
        self._pieces, self._frusta = self._add_map(), self._add_cameras()
        self._skies: dict[int, Any] = {}
        self._showing, self._playing = threading.Lock(), threading.Event()
        self._add_controls()
        self.server.on_client_connect(self._welcome)
        self.server.on_client_disconnect(lambda client: self._skies.pop(client.client_id, None))
        threading.Thread(target=self._play, name="bgs-view-play", daemon=True).start()
        self._show_frame()

    @property
    def url(self) -> str:
        """Where it is."""
        host = self.server.get_host()
        return f"http://{'[' + host + ']' if ':' in host else host}:{self.server.get_port()}"

    def stop(self) -> None:
        """Close the server."""
        self._playing.clear()
        self.server.stop()

    def look_from(self, at: int) -> None:
        """Let all clients look from the frame at this position of the trajectory."""
        pose = self._trajectory.T_world_cam[at]
        for client in self.server.get_clients().values():
            with client.atomic():
                client.camera.wxyz, client.camera.position = _wxyz(pose), pose[:3, 3]
                client.camera.fov = self._fov

    def _about_map(self) -> Iterable[str]:
        splats = self._splats
        if len(splats) < splats.whole:
            yield f"{len(splats):,} of {splats.whole:,} Gaussians, those that cover most; --max-gaussians N shows more"
        else:
            yield f"{len(splats):,} Gaussians"
        if splats.sh_degree:
            yield "colours do not change with the direction here, as they do where the map is rendered"
        if splats.keyframes is None:
            yield "the run did not save which keyframe each Gaussian belongs to: the map can't be shown as it grew"

    def _set_scene(self) -> None:
        # viser would show the page to the internet whenever a client asks for that.
        self.server.request_share_url = lambda *_, **__: None
        self.server.gui.configure_theme(show_logo=False, show_share_button=False, dark_mode=True)
        self.server.scene.set_up_direction("-y")
        self.server.scene.world_axes.visible = False
        # As where the map is rendered: black where nothing is.
        self.server.scene.set_background_image(np.zeros((2, 2, 3), np.uint8), format="png")

    def _add_map(self) -> list[tuple[int, Any]]:
        """Pieces of the map, each with the number of the first of its keyframes."""
        splats = self._splats
        keyframes = np.full(len(splats), -1) if splats.keyframes is None else splats.keyframes
        order = splats.sky + np.argsort(keyframes[splats.sky :], kind="stable")
        starts = np.unique(keyframes[order], return_index=True)[1]
        pieces = []
        for part in np.split(order, starts[:: -(-len(starts) // _PIECES)][1:]) if len(order) else []:
            first = int(keyframes[part[0]])
            pieces.append((first, self.server.scene.add_gaussian_splats(f"/map/{first}", *splats.arrays(part))))
        return pieces

    def _add_cameras(self) -> list[Any]:
        frusta = []
        for at in range(0, len(self._trajectory), -(-len(self._trajectory) // _MOST_FRUSTA)):
            pose = self._trajectory.T_world_cam[at]
            frustum = self.server.scene.add_camera_frustum(
                f"/cameras/{at}",
                fov=self._fov,
                aspect=self._aspect,
                scale=0.15,
                color=_COLORS[bool(self._mapped[at])],
                wxyz=_wxyz(pose),
                position=pose[:3, 3],
                visible=False,
            )
            frustum.on_click(lambda _, at=at: self._go_to(at))
            frusta.append(frustum)
        return frusta

    def _add_controls(self) -> None:
        gui, numbers, last = self.server.gui, self._trajectory.numbers.tolist(), len(self._trajectory) - 1
        # As HTML, since Markdown would take what is in a path for its own signs.
        gui.add_html(_as_html(self.notes))
        self._sky = gui.add_checkbox("Sky", True, visible=self._splats.sky > 0)
        cameras = gui.add_checkbox("Cameras", False)
        age = {"min": numbers[0], "max": max(numbers[-1], numbers[0] + 1), "step": 1, "initial_value": numbers[-1]}
        until = gui.add_slider("Map up to frame", **age, visible=self._splats.keyframes is not None and last > 0)
        self._at = gui.add_slider("Position", min=0, max=max(last, 1), step=1, initial_value=0, visible=last > 0)
        self._follow = gui.add_checkbox("Look from the frame", True)
        play = gui.add_checkbox("Play", False, visible=last > 0)
        self._about = gui.add_html("")
        blank = np.zeros((2, 2, 3), np.uint8)
        self._images = {what: gui.add_image(blank, label=what) for what in ("Ground truth", "Render")}
        self._images["Depth"] = gui.add_image(blank, label=f"Depth, 0 to {self._max_depth_m:.0f} m")
        self._sky.on_update(lambda _: _set_visible(self._skies.values(), self._sky.value))
        cameras.on_update(lambda _: _set_visible(self._frusta, cameras.value))
        until.on_update(lambda _: self._show_until(until.value))
        self._at.on_update(lambda _: self._show_frame())
        play.on_update(lambda _: self._playing.set() if play.value else self._playing.clear())

    def _welcome(self, client: Any) -> None:
        """The first look, and a sky of the client's own, which moves with its camera."""
        client.camera.near, client.camera.far = _NEAR_M, _FAR_M
        if self._splats.sky:
            arrays = self._splats.arrays(slice(self._splats.sky))
            sky = client.scene.add_gaussian_splats("/sky", *arrays, visible=self._sky.value)
            self._skies[client.client_id] = sky

            def follow(camera: Any) -> None:
                sky.position = camera.position

            client.camera.on_update(follow)
        self.look_from(self._at.value)

    def _show_until(self, number: int) -> None:
        for first, piece in self._pieces:
            piece.visible = first <= number

    def _go_to(self, at: int) -> None:
        if self._at.value == at:
            self._show_frame()
        self._at.value = at

    def _show_frame(self) -> None:
        """The images of the chosen frame, and the look from it."""
        with self._showing:
            at = min(self._at.value, len(self._trajectory) - 1)
            number = int(self._trajectory.numbers[at])
            words = [f"Frame {number}{', keyframe' if self._mapped[at] else ''}"]
            for what, shown in self._images.items():
                try:
                    picture = self._picture(what, number)
                except BenchError as error:
                    picture = None
                    words.append(str(error))
                shown.visible = picture is not None
                if picture is not None:
                    shown.image = picture
            self._about.content = _as_html(words)
            if self._follow.value:
                self.look_from(at)

    def _picture(self, what: str, number: int) -> Image | None:
        """RGB (H, W, 3) of a frame; None where the run saved none, ``BenchError`` for one that can't be read."""
        if what == "Ground truth":
            return self._saved.frame(self._saved.position_of(number)).left
        if what == "Render":
            return self._saved.render("left", number)
        depth = self._saved.depth("left", number)
        return None if depth is None else colored(depth, depth_scale(self._max_depth_m))

    def _play(self) -> None:
        """Frame by frame, from the chosen one on and again from the first, while it is switched on."""
        while True:
            self._playing.wait()
            self._at.value = (self._at.value + 1) % len(self._trajectory)
            time.sleep(1 / _FRAMES_PER_S)


def _wxyz(pose: Float) -> Float:
    """Rotation of a pose (4, 4) as w, x, y, z."""
    return np.roll(rotation_to_quaternion(pose[:3, :3]), 1)


def _as_html(lines: Iterable[str]) -> str:
    return "".join(f'<p style="margin: 0.3em 1em">{html.escape(line)}</p>' for line in lines)


def _set_visible(handles: Iterable[Any], visible: bool) -> None:
    for handle in list(handles):
        handle.visible = visible
