"""Poses by which a demo calibrates."""

import numpy as np

from softrobot_twin.ros.demo import plan_demo
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.study.calibration_demo import poses_of_device
from test.places import SCENES


def test_poses_are_where_the_device_rests_at_setpoints_of_the_twin_within_the_box():
    twin, device = (Simulation.from_scene_file(SCENES / f"{name}.yaml") for name in ("emio", "emio_device"))
    box = np.array([[-0.04, -0.04, -0.16], [0.04, 0.04, -0.12]])
    poses = poses_of_device(twin, device, box, 2, 0.0, seed=3)
    assert len(poses) == 2 and not np.allclose(poses[0].setpoints, poses[1].setpoints)
    for pose in poses:
        for simulation, apart in ((device, 1e-6), (twin, 2e-2)):
            simulation.reset()
            for share in np.linspace(0.1, 1.0, 10):
                simulation.step(CommandSetpoints(share * pose.setpoints, 1.0))
            simulation.step(CommandSetpoints(pose.setpoints, 1.0))
            assert np.abs(simulation.marker_positions() - pose.markers).max() < apart
        tip = twin.effector_positions()[0]
        assert (box[0] - 1e-3 < tip).all() and (tip < box[1] + 1e-3).all()


def test_the_demo_of_emio_is_planned_with_thirty_poses_and_that_of_others_without(tmp_path):
    plan = plan_demo("emio", tmp_path, 10.0, view=False)
    assert plan.calibration.count == 30 and plan.calibration.device_scene.name == "emio_device.yaml"
    assert plan_demo("diamond", tmp_path, 10.0, view=False).calibration is None
