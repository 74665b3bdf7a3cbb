"""Contact forces in a recording."""

import numpy as np
import pytest
from rerun_world import GRAVITY, MASS, World, entities, read

from geort_drake.rerun import ContactSpec


def test_contact_arrows_appear_with_the_contact_and_vanish_with_it(tmp_path):
    """A resting ball has arrows, none while a kick makes it fly, and again when it is back."""
    world = World(height=0.0499).finalize().record(tmp_path / "contact.rrd", period=1 / 64)
    with world.recorder:
        world.simulator.AdvanceTo(0.25)
        world.kick(1.0)
        world.simulator.AdvanceTo(0.75)
    times, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    times, touching = np.array(times), np.array([len(v) > 0 for v in vectors])
    back = 0.25 + 2 * 1.0 / GRAVITY  # s
    assert touching[(times > 0.01) & (times < 0.25)].all()
    assert not touching[(times > 0.26) & (times < back - 0.01)].any()
    assert touching[times > back + 0.02].all()


@pytest.mark.parametrize("contact_model", ["point", "hydroelastic"])
def test_contact_force_of_a_resting_ball_is_its_weight(tmp_path, contact_model):
    """Both arrows of a contact are as long as the force, and opposite; the series holds the force."""
    world = World(0.0499, contact_model=contact_model).finalize()
    spec = ContactSpec(metres_per_newton=0.1, groups={"ball": [world.ball], "arm": [world.upper]})
    world.record(tmp_path / "rest.rrd", contact=spec, until=1.0)
    _, vectors = read(world.recorder.path, "/world/contact/forces", "Arrows3D:vectors")
    _, origins = read(world.recorder.path, "/world/contact/forces", "Arrows3D:origins")
    up, down = sorted(vectors[-1].tolist(), key=lambda v: -v[2])
    np.testing.assert_allclose(up, [0, 0, 0.1 * MASS * GRAVITY], atol=5e-3)
    np.testing.assert_allclose(down, np.negative(up), atol=1e-6)
    # A sphere of compliant facets may roll onto one of them.
    np.testing.assert_allclose(origins[-1], np.zeros((2, 3)), atol=2e-2)
    np.testing.assert_allclose(origins[-1][:, 2], 0, atol=1e-3)
    for group, weight in (("ball", MASS * GRAVITY), ("arm", 0.0)):
        _, force = read(world.recorder.path, f"/contact/force/{group}", "Scalars:scalars")
        np.testing.assert_allclose(force[-1], [weight], atol=2e-2)
        _, names = read(world.recorder.path, f"/contact/force/{group}", "SeriesLines:names")
        assert names[0].tolist() == [group]


def test_without_groups_each_touched_body_has_a_series(tmp_path):
    """The ground does not move, and nothing touches the arm."""
    world = World(height=0.0499).finalize().record(tmp_path / "bodies.rrd", until=0.5)
    series = {entity for entity in entities(world.recorder.path) if entity.startswith("/contact/")}
    assert series == {"/contact/force/ball/body"}
    _, force = read(world.recorder.path, "/contact/force/ball/body", "Scalars:scalars")
    np.testing.assert_allclose(force[-1], [MASS * GRAVITY], atol=2e-2)
