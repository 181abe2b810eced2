"""The arm in a browser while it moves: MuJoCo's web viewer, on this machine's own address alone.

MuJoCo 4.0's viewer listens on every network interface and asks for no password, so its socket is made here.
"""

import contextlib
import io
import logging
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco

from qjrl.artifacts import ArtifactError

log = logging.getLogger(__name__)

LOOPBACK = "127.0.0.1"


@contextmanager
def live_view(model: mujoco.MjModel, port: int) -> Iterator[Callable[[Any], None]]:
    """Serve the viewer; yields what shows a plant (with `joint_positions` (nq,)) in its present pose.

    Raises:
        ArtifactError: the port is taken, or this MuJoCo has no web viewer.
    """
    viewer = _start(model, port)
    log.info("deploy: the arm is shown at http://%s:%d", LOOPBACK, port)
    data = mujoco.MjData(model)

    def show(plant: Any) -> None:
        data.qpos[:] = plant.joint_positions
        mujoco.mj_forward(model, data)
        viewer.sync(model, data)

    try:
        yield show
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            viewer.close()


def _start(model: mujoco.MjModel, port: int) -> Any:
    """The viewer's handle, once it listens; its own thread draws."""
    bound, listens = _bind(port), threading.Event()
    try:
        from mujoco.studio import app, launch_thread, plugin, viewer_protocol, web_viewer
    except ImportError as error:
        raise ArtifactError(f"deploy.view: this mujoco has no web viewer: {error}") from error
    logging.getLogger("WebServer").setLevel(logging.WARNING)
    config = viewer_protocol.ViewerConfig(title="qjrl", gfx="web", http_port=port)
    viewer_plugins, sim_plugins = plugin.split_plugins([app.App()])

    def serve(endpoint: Any) -> None:
        with (
            _socket_given(web_viewer.web_server, bound),
            contextlib.redirect_stdout(io.StringIO()),
        ):  # it prints a banner
            viewer = web_viewer.WebViewer(config, endpoint, model=model, plugins=viewer_plugins)
        listens.set()
        viewer_protocol.run_viewer_loop(viewer)

    handle = launch_thread.launch_thread(serve, sim_plugins=sim_plugins)
    while not listens.wait(0.1) and handle.is_running():  # which raises what the viewer died of
        continue
    return handle


@contextmanager
def _socket_given(web_server: Any, bound: socket.socket) -> Iterator[None]:
    """The viewer gets this socket where it would make one."""
    original = web_server.bind_public_socket
    web_server.bind_public_socket = lambda *_: bound
    try:
        yield
    finally:
        web_server.bind_public_socket = original


def _bind(port: int) -> socket.socket:
    """A socket on the loopback interface."""
    bound = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((LOOPBACK, port))
    except OSError as error:
        bound.close()
        raise ArtifactError(f"deploy.port: got {port}, which is taken or not allowed: {error.strerror}") from error
    return bound
