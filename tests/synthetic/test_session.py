"""A recording's name decides on everything that is filmed."""

from types import SimpleNamespace

import numpy as np
import pytest

from assemblyhands_core.synthetic import session
from assemblyhands_core.synthetic.rig import assembly_rig
from assemblyhands_core.synthetic.session import Order, Session

NAME = "nusar-2021_action_both_1001-c09a_1001_user_id_2022-03-02_091830"
SAME_PERSON = "nusar-2021_action_both_1001-a12b_1001_user_id_2022-03-02_151830"


def test_a_name_decides_on_person_day_and_script() -> None:
    one, other = Order(NAME, "assembly", 2.0), Order(SAME_PERSON, "assembly", 2.0)
    assert one.num_frames == 60 and Order(NAME, "assembly", 0.001).num_frames == 1
    takes = [order.write_take() for order in (one, other)]
    assert takes[0].subject.seed == takes[1].subject.seed == 1001 and takes[0].seed != takes[1].seed
    assert one.write_take().state_at(1.0).joints_world_mm.tobytes() == takes[0].state_at(1.0).joints_world_mm.tobytes()
    rig, expected = one.build_rig(), assembly_rig(20220302)
    assert all((rig.exo[n].T_camera_from_world == c.T_camera_from_world).all() for n, c in expected.exo.items())
    assert len(Order(NAME, "desktop", 2.0).build_rig().exo) == 12


def test_fewer_pictures_a_second_show_the_same_instants(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "render", lambda *_, **__: SimpleNamespace(image=np.zeros((2, 2), np.uint8)))
    often, seldom = (Session(Order(NAME, "assembly", 4.0, rate_hz=rate)) for rate in (30, 2))
    assert Order(NAME, "assembly", 4.0, rate_hz=2).num_frames == 8
    shots = often.shoot(45), seldom.shoot(3)
    assert shots[0].state.joints_world_mm.tobytes() == shots[1].state.joints_world_mm.tobytes()
    assert [shot.truth.frame for shot in shots] == [45, 3]


def test_a_name_that_tells_nobody_is_refused() -> None:
    with pytest.raises(ValueError, match="'monday' is no recording name"):
        Order("monday", "assembly", 2.0)
