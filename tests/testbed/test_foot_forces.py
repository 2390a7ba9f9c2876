"""Forces of the table on the feet, as they are kept beside a trial."""

import numpy as np
import pytest

from testbed.actions.rotate import Rotate
from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.files import DamagedFileError
from testbed.foot_forces import FootForces, load_foot_forces, save_foot_forces
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Phase
from testbed.trial import Trial


def test_they_come_back_as_they_were_and_a_cut_file_is_told(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "feet.parquet"
    feet = FootForces(np.arange(4) / 10, np.array([5, 1, 7]), rng.normal(size=(4, 3, 3)))
    save_foot_forces(feet, path)
    back = load_foot_forces(path)
    np.testing.assert_array_equal(back.time_s, feet.time_s)
    np.testing.assert_array_equal(back.particle, feet.particle)
    np.testing.assert_allclose(back.force, feet.force, rtol=1e-6)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(DamagedFileError, match=r"feet\.parquet"):
        load_foot_forces(path)


@pytest.mark.parametrize("force", [np.zeros((4, 2, 3)), np.full((4, 1, 3), np.nan)])
def test_other_shapes_and_nan_are_refused(force):
    with pytest.raises(InvalidValueError, match="force"):
        FootForces(np.arange(4) / 10, np.array([0]), force)


def test_in_a_turn_they_carry_the_weight_and_oppose_the_motion():
    obj = load_object("L2")
    trajectory, contacts = SimulationRunner().run_with_contacts(Trial(obj, Rotate(0, duration=2.0)), every=10)
    feet = contacts.foot_forces(trajectory.time_s)
    assert feet.force.shape == (-(-len(trajectory.time_s) // 10), 54, 3)
    np.testing.assert_array_equal(feet.time_s, trajectory.time_s[::10])
    steady = np.flatnonzero(trajectory.phase[::10] == Phase.STEADY)[10:-1]
    weight = feet.force[steady, :, 2].sum(1)
    np.testing.assert_allclose(weight, obj.total_mass * GRAVITY, rtol=0.05)  # the rest hangs on the gripper
    drag = np.linalg.norm(feet.force[steady, :, :2], axis=2)
    far = np.linalg.norm(obj.shape.particles[feet.particle] - obj.shape.grasps[0].position, axis=1) > 0.03
    np.testing.assert_allclose(drag[:, far], 0.5 * feet.force[steady][:, far, 2], rtol=0.01)


def test_a_scale_has_no_feet():
    with pytest.raises(InvalidValueError, match="anything but a weighing"):
        SimulationRunner().run_with_contacts(Trial(load_object("L2"), Weigh()))
