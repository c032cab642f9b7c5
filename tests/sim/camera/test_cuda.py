"""The GPU paints almost what the CPU paints. Without a GPU, numba's simulator runs the kernels on small pictures."""

import os
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from wrongturn_protocol import SegmentationClass, Weather
from wrongturn_sim.camera import Camera, CameraError, World, look_of, render_batch
from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv

LOW = {"width": 12, "height": 8, "focal": 8.0, "cx": 6.0, "cy": 3.5}
TALL = {"width": 3, "height": 70, "focal": 40.0, "cx": 1.5, "cy": 30.0}
PITCHED = {**LOW, "pitch": 0.1, "yaw": 0.3}
CLASSES_APART, COLOURS_APART = 1e-5, 1e-4
"""Greatest shares of the pixels on a GPU with another class, and with a colour that differs by more than 1.

CPU and GPU round differently, so a pixel exactly on an edge can fall to either side. Measured on an H200: at most
3.4e-6 and 5.3e-5. The CPU without fast arithmetic differs as much from the CPU with it.
"""
KINDS = (Weather.HARD_RAIN_NOON, Weather.CLEAR_SUNSET)

SCRIPT = """
import sys
import numpy as np
from wrongturn_networks import load_town
from wrongturn_sim.camera import Camera, World
from wrongturn_sim.camera.cuda import CudaRenderer

given = np.load(sys.argv[1], allow_pickle=True)
world, number = World.of(load_town("junctions")), len(given["poses"])
made, kinds = {}, [Camera(**camera) for camera in given["cameras"]]
mixed = CudaRenderer(world, [kinds[0], kinds[2], kinds[0]], number + 1)
both = {"kinds": given["kinds"], "targets": [2, 1], "others": given["others"], "begins": given["begins"]}
mixed.render(given["looks"], given["seeds"], given["poses"], given["ticks"], **both)
made["mixed"] = np.asarray(mixed.rgb)[[2, 1]]
for i, camera in enumerate(given["cameras"]):
    renderer = CudaRenderer(world, Camera(**camera), number + 1)
    targets = np.arange(number, 0, -1)
    renderer.render(
        given["looks"], given["seeds"], given["poses"], given["ticks"], kinds=given["kinds"], targets=targets,
        others=given["others"], begins=given["begins"],
    )
    made[f"rgb{i}"] = np.asarray(renderer.rgb)[targets]
    made[f"segmentation{i}"] = np.asarray(renderer.segmentation)[targets]
    if i == 0:
        rgb, segmentation = renderer.keep(np.array([2]))
        # Paint another picture in the same place: the kept one must stay.
        renderer.render(given["looks"][:1], given["seeds"][:1], given["poses"][1:2], [9], targets=[2])
        made["kept"], made["new"] = np.asarray(rgb[2]), np.asarray(renderer.rgb[2])
        made["kept_segmentation"] = np.asarray(segmentation[2])
np.savez(sys.argv[2], **made)
"""


def on_cpu(world, camera, looks, seeds, poses, ticks, others=None, begins=None):
    shape = len(poses), camera.height, camera.width
    rgb, segmentation = np.empty((*shape, 3), np.uint8), np.empty(shape, np.uint8)
    render_batch(world, camera, looks, seeds, poses, ticks, rgb, segmentation, others=others, begins=begins)
    return rgb, segmentation


def beside(poses, counts):
    """Return cars and pedestrians around each pose, and where those of each begin."""
    others = []
    for pose, count in zip(poses, counts, strict=True):
        for k in range(count):
            ahead, left, walks = 4.0 + 3.0 * k, 2.0 * (-1) ** k, k % 3 == 2
            x = pose[0] + ahead * np.cos(pose[2]) - left * np.sin(pose[2])
            y = pose[1] + ahead * np.sin(pose[2]) + left * np.cos(pose[2])
            body = (0.5, 0.5, 1.8) if walks else (4.5, 1.9, 1.5 + 0.3 * k)
            others.append((x, y, pose[2] + 0.7 * k, *body, float(walks), 17.0 * k))
    return np.array(others).reshape(-1, 8), np.concatenate(([0], np.cumsum(counts)))


def test_simulated_kernels_paint_what_the_cpu_paints(world, town, before, tmp_path):
    approaches = list(town.approaches.values())
    poses = np.array([before(approaches[0], 12.0), before(approaches[2], 3.0)])
    poses[1, 2] += 0.4
    looks, kinds = np.array([look_of(kind) for kind in KINDS]), np.array([1, 0])
    seeds, ticks = np.array([3, 2**40 + 4]), np.array([5, 6])
    cameras = [LOW, TALL, PITCHED]
    given, made = tmp_path / "given.npz", tmp_path / "made.npz"
    others, begins = beside(poses, (4, 1))
    np.savez(
        given,
        others=others,
        begins=begins,
        looks=looks,
        kinds=kinds,
        seeds=seeds,
        poses=poses,
        ticks=ticks,
        cameras=np.array(cameras, object),
    )
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "error::RuntimeWarning", "-c", textwrap.dedent(SCRIPT), str(given), str(made)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    painted = np.load(made)
    for i, camera in enumerate(cameras):
        rgb, segmentation = on_cpu(world, Camera(**camera), looks[kinds], seeds, poses, ticks, others, begins)
        alone = on_cpu(world, Camera(**camera), looks[kinds], seeds, poses, ticks)[1]
        assert len(np.unique(segmentation)) > 3
        assert (alone != segmentation).any()
        np.testing.assert_array_equal(painted[f"segmentation{i}"], segmentation)
        assert np.abs(painted[f"rgb{i}"].astype(int) - rgb).max() <= 1
    np.testing.assert_array_equal(painted["mixed"], [painted["rgb0"][0], painted["rgb2"][1]])
    np.testing.assert_array_equal(painted["kept"], painted["rgb0"][0])
    np.testing.assert_array_equal(painted["kept_segmentation"], painted["segmentation0"][0])
    assert (painted["new"] != painted["kept"]).any()


def _has_gpu() -> bool:
    from wrongturn_sim.camera.cuda import device

    return bool(device.is_available())


gpu = pytest.mark.skipif(not _has_gpu(), reason="there is no NVIDIA GPU that numba.cuda can use")


@pytest.mark.skipif(_has_gpu(), reason="there is a GPU")
def test_without_a_gpu_the_error_tells_what_to_do():
    with pytest.raises(CameraError, match=r"finds no GPU.*give backend='cpu'"):
        WrongturnVectorEnv(2, town="junctions", track="camera", backend="cuda")


@gpu
@pytest.mark.parametrize("camera", [Camera(), Camera(pitch=0.1), Camera(width=320, height=120, cx=160.0, cy=50.0)])
def test_gpu_paints_almost_what_the_cpu_paints(world: World, town, before, camera):
    from wrongturn_sim.camera.cuda import CudaRenderer

    approaches = list(town.approaches.values())
    poses = np.array([before(approaches[i % len(approaches)], 2.0 + 1.3 * i) for i in range(24)]).repeat(6, axis=0)
    looks = np.array([look_of(weather) for weather in Weather] * 24)
    numbers = np.arange(len(poses))
    others, begins = beside(poses, numbers % 5)
    rgb, segmentation = on_cpu(world, camera, looks, numbers, poses, numbers, others, begins)
    assert {int(SegmentationClass.VEHICLE), int(SegmentationClass.PEDESTRIAN)} <= set(np.unique(segmentation).tolist())
    renderer = CudaRenderer(world, camera, len(poses))
    renderer.render(looks, numbers, poses, numbers, others=others, begins=begins)
    assert (np.asarray(renderer.segmentation) != segmentation).mean() <= CLASSES_APART
    assert (np.abs(np.asarray(renderer.rgb).astype(int) - rgb).max(-1) > 1).mean() <= COLOURS_APART


@gpu
def test_torch_shares_the_memory_of_a_gpus_observations():
    torch = pytest.importorskip("torch")
    env = WrongturnVectorEnv(2, town="junctions", track="segmentation", backend="cuda", copy=False)
    cpu = WrongturnVectorEnv(2, town="junctions", track="segmentation")
    seen, _ = env.reset(seed=5)
    wanted, _ = cpu.reset(seed=5)
    shared = torch.as_tensor(seen["segmentation"], device="cuda")
    actions = np.array([[0.0, 1.0, 0.0], [0.3, 1.0, 0.0]], np.float32)
    for _ in range(3):
        np.testing.assert_array_equal(shared.cpu().numpy(), np.asarray(seen["segmentation"]))
        # A few pixels on edges may fall to either side.
        assert (shared.cpu().numpy() != wanted["segmentation"]).sum() <= 3
        env.step(actions)
        wanted = cpu.step(actions)[0]
