"""The adapters of ``docs/examples/adapters`` with stand-in networks, of the shapes of the published ones.

Each stand-in checks what it is given, keeps it, and answers with what turns the car off the road to the right at once,
so that a suite takes few steps.
"""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import numpy as np

FOLDER = Path(__file__).parents[2] / "docs/examples/adapters"


def adapter(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"adapter_{name}", FOLDER / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def same(given: np.ndarray, shape: tuple[int, ...], low: float, high: float) -> np.ndarray:
    assert isinstance(given, np.ndarray)
    assert (given.dtype, given.shape) == (np.dtype(np.float32), shape)
    assert low <= given.min() <= given.max() <= high
    return given


def bend(times, right: int = 1, pace: float = 6.0) -> np.ndarray:
    """Return the waypoints of a curve of 8 m to the right, with the second column to ``right``."""
    angles = pace * np.asarray(times, float) / 8.0
    return 8.0 * np.stack([np.sin(angles), right * (1.0 - np.cos(angles))], axis=1)


def of_tcp(image, state, target_point):
    of_tcp.given = same(image, (1, 3, 256, 900), -2.2, 2.7), same(state, (1, 9), -60, 60), target_point
    assert target_point.tolist() == state[:, 1:3].tolist()
    waypoints = bend((0.5, 1.0, 1.5, 2.0))[:, ::-1] * (1.0, -1.0)
    return {
        "pred_wp": waypoints[None],
        "mu_branches": np.array([[3.0, 3.0]]),  # accelerates by 0.5, steers by 0.5 to the right
        "sigma_branches": np.array([[1.0 + 2.0 / 3.0, 1.0 + 2.0 / 3.0]]),
    }


def of_transfuser(image, target_point, velocity):
    given = same(image, (1, 3, 160, 704), 0, 255), same(target_point, (1, 2), -60, 60), same(velocity, (1, 1), 0, 22)
    of_transfuser.given = given
    return bend((0.5, 1.0, 1.5, 2.0))[None] - (1.3, 0.0)


def of_navsim(camera_feature, status_feature):
    of_navsim.given = same(camera_feature, (1, 3, 256, 1024), 0, 1), same(status_feature, (1, 8), -500, 500)
    path = bend(0.5 * np.arange(1, 9), right=-1)
    return np.concatenate([path, np.zeros((8, 1))], axis=1)[None]


def of_simlingo(pictures, prompt, speed):
    of_simlingo.given = same(pictures, (1, 1, 2, 3, 448, 448), -2.2, 2.7), prompt, same(speed, (1, 1), 0, 22)
    return bend(0.25 * np.arange(1, 11))[None], bend(np.arange(1, 21) / 6.0)[None], [""]


def of_openpilot(**inputs):
    shapes = {
        "input_imgs": (1, 12, 128, 256), "big_input_imgs": (1, 12, 128, 256), "desire": (1, 100, 8),
        "traffic_convention": (1, 2), "lateral_control_params": (1, 2), "prev_desired_curv": (1, 100, 1),
        "features_buffer": (1, 99, 512),
    }  # fmt: skip
    of_openpilot.given = {name: same(inputs.pop(name), shape, -1, 255) for name, shape in shapes.items()}
    assert not inputs
    plan = np.zeros((5, 991))
    plan[3, -1] = 1.0
    plan[3, :495].reshape(33, 15)[:, :2] = bend(10.0 * (np.arange(33) / 32) ** 2)
    ones = {"hidden_state": np.ones((1, 512)), "desired_curvature": np.full((1, 2), 0.5)}
    return {"plan": plan.reshape(1, 4955), **ones}


def of_carton(seen):
    of_carton.given = same(seen, (1, 64, 192, 9), -1, 4)
    return np.array([[1.5, 0.8]])


NETWORKS = {
    "Tcp": ("tcp", of_tcp),
    "TransFuser": ("transfuser", of_transfuser),
    "Navsim": ("navsim", of_navsim),
    "SimLingo": ("simlingo", of_simlingo),
    "Openpilot": ("openpilot", of_openpilot),
    "Carton": ("carton", of_carton),
}


def with_stand_in(name: str) -> type:
    file, network = NETWORKS[name]
    adapted = getattr(adapter(file), name)
    return type(name, (adapted,), {"__init__": lambda self: adapted.__init__(self, network), "__module__": __name__})


Tcp, TransFuser, Navsim, SimLingo, Openpilot, Carton = map(with_stand_in, NETWORKS)
