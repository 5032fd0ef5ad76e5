"""The labels for CVAT have the joints of the COCO files, in their order."""

import xml.etree.ElementTree as ElementTree

from assemblyhands_core.data.cvat_labels import cvat_labels
from assemblyhands_core.hands.joints import BONES, JOINT_NAMES


def test_each_hand_is_a_skeleton_of_its_joints_and_bones() -> None:
    labels = cvat_labels()
    assert [label["name"] for label in labels] == ["right_hand", "left_hand"]
    for label in labels:
        assert [sublabel["name"] for sublabel in label["sublabels"]] == list(JOINT_NAMES)
        drawing = ElementTree.fromstring(f"<svg>{label['svg']}</svg>")
        nodes, edges = drawing.findall("circle"), drawing.findall("line")
        assert [node.get("data-label-name") for node in nodes] == list(JOINT_NAMES)
        assert [node.get("data-node-id") for node in nodes] == [str(n) for n in range(1, 22)]
        places = {(float(node.get("cx", "")), float(node.get("cy", ""))) for node in nodes}
        assert len(places) == 21 and all(0 <= value <= 100 for place in places for value in place)
        pairs = {(edge.get("data-node-from"), edge.get("data-node-to")) for edge in edges}
        assert pairs == {(str(a + 1), str(b + 1)) for a, b in BONES}
