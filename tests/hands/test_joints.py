import numpy as np

from assemblyhands_core.hands.body import ARMS, BODY_KEYPOINT_NAMES, hand_center
from assemblyhands_core.hands.joints import BONES, JOINT_NAMES, NUM_JOINTS, ROOT, WRIST, WRIST_FIRST_ORDER


def test_order_is_the_release_order() -> None:
    assert len(JOINT_NAMES) == NUM_JOINTS == 21
    assert [JOINT_NAMES[j] for j in (0, 3, 4, 7, ROOT, 16, WRIST)] == [
        "thumb_tip", "thumb_cmc", "index_tip", "index_mcp", "middle_mcp", "pinky_tip", "wrist",
    ]  # fmt: skip


def test_bones_form_five_chains_that_end_in_the_wrist() -> None:
    assert len(BONES) == 20
    assert {child for child, parent in BONES if parent == WRIST} == {3, 7, 11, 15, 19}
    assert all(parent == child + 1 for child, parent in BONES if parent != WRIST)


def test_wrist_first_order_is_the_published_mapping() -> None:
    assert WRIST_FIRST_ORDER == (20, 3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12, 19, 18, 17, 16)


def test_hand_center_lies_a_third_of_the_forearm_beyond_the_wrist() -> None:
    elbow, wrist = np.array([0.0, 0.0, 0.0]), np.array([240.0, 0.0, 30.0])
    np.testing.assert_array_equal(hand_center(elbow, wrist), [320.0, 0.0, 40.0])


def test_arms_are_of_one_side() -> None:
    for side, arm in ARMS.items():
        assert [BODY_KEYPOINT_NAMES[k] for k in arm] == [f"{side}_shoulder", f"{side}_elbow", f"{side}_wrist"]
