"""The consistency check against the rule written out pixel by pixel."""

import numpy as np

from nbv.config import CameraConfig, DenseConfig
from nbv.dense.stereo import PosedViews, check_consistency, pixel_matrix
from nbv.geometry.frames import look_at

CAMERA = CameraConfig(width_px=32, height_px=24, focal_px=40.0)
CONFIG = DenseConfig(
    agreeing_views=2, consistency_views=3, consistency_relative_depth=0.05, consistency_px=0.35
)
TARGET = np.array([0.0, 0.0, 0.8])


def one_pixel(name, row, column, depths, poses):
    """Depths along the pixel's ray in which the views agree, the view's own first."""
    matrix, inverse = pixel_matrix(CAMERA), np.linalg.inv(pixel_matrix(CAMERA))
    depth = float(depths[name][row, column])
    world = np.linalg.inv(poses[name]) @ np.append(inverse @ [column, row, 1.0] * depth, 1.0)
    agreed = [depth]
    for other in depths:
        if other == name:
            continue
        seen = (poses[other] @ world)[:3]
        if seen[2] <= 0:
            continue
        x, y = (matrix @ seen)[:2] / seen[2]
        j, i = round(x), round(y)
        if not (0 <= i < CAMERA.height_px and 0 <= j < CAMERA.width_px):
            continue
        measured = float(depths[other][i, j])
        if not abs(measured - seen[2]) < CONFIG.consistency_relative_depth * seen[2]:
            continue
        back = (poses[name] @ np.linalg.inv(poses[other]) @ np.append(seen * measured / seen[2], 1.0))[:3]
        x, y = (matrix @ back)[:2] / back[2]
        if (x - column) ** 2 + (y - row) ** 2 < CONFIG.consistency_px**2:
            agreed.append(float(back[2]))
    return agreed


def test_every_pixel_follows_the_rule():
    """A wall seen from four sides, with noise and holes; some source views see only a part of a view."""
    rng = np.random.default_rng(3)
    poses, depths = {}, {}
    for k, (x, y) in enumerate([(0.0, -3.0), (0.4, -3.0), (-0.5, -2.8), (0.9, -2.2)]):
        name = f"v{k}"
        aim = TARGET + np.array([0.5 * (k == 3), 0.0, 0.0])
        poses[name] = look_at(np.array([x, y, 0.9]), aim)
        rays = (
            np.stack([*np.meshgrid(np.arange(32), np.arange(24)), np.ones((24, 32))], axis=-1)
            @ np.linalg.inv(pixel_matrix(CAMERA)).T
        )
        forward = rays @ poses[name][:3, :3]
        depth = -y / forward[..., 1]  # of the plane y = 0
        depth *= 1 + 0.03 * rng.standard_normal(depth.shape)
        depth[rng.random(depth.shape) < 0.15] = np.nan
        depths[name] = depth.astype(np.float32)
    checked = check_consistency(depths, PosedViews({}, poses, CAMERA, TARGET, CONFIG))
    wrong = total = kept = 0
    for name, depth in depths.items():
        for row, column in np.argwhere(np.isfinite(depth)):
            agreed = one_pixel(name, row, column, depths, poses)
            got = checked[name]
            total += 1
            kept += len(agreed) >= CONFIG.agreeing_views
            expected = np.mean(agreed) if len(agreed) >= CONFIG.agreeing_views else np.nan
            wrong += not np.isclose(got[row, column], expected, rtol=1e-5, equal_nan=True)
        assert np.isnan(checked[name][~np.isfinite(depth)]).all()
    assert 0.3 * total < kept < 0.99 * total
    assert wrong <= 0.002 * total  # a projection half-way between two pixels may round either way
