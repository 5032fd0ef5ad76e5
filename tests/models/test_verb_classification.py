"""Files of verb classifiers say what they were trained for; objects that are not known say nothing."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from verb_clips import VERBS, moving_clip

from assemblyhands_core.data.pose_sequences import PoseSequenceConfig
from assemblyhands_core.data.verb_segments import UNKNOWN_NOUN
from assemblyhands_core.models.msg3d import MSG3D, MSG3DConfig
from assemblyhands_core.models.pretrained import save_weights
from assemblyhands_core.models.svegonet import SVEgoNet, SVEgoNetConfig
from assemblyhands_core.models.verb_classification import VerbClassifier, object_features

TINY = MSG3DConfig(num_classes=3, num_gcn_scales=2, num_g3d_scales=2, c1=6, c2=6, c3=12)
SEQUENCE = PoseSequenceConfig(
    rate_hz=15, context_keys=0, num_frames=8, length="resample", centre="wrist", scale="none", hands=("left", "right")
)
NOUNS = ("bolt", "wheel")
CLIPS = [moving_clip(VERBS[number % 3], number) for number in range(7)]


def _network(**changes: Any) -> MSG3D:
    torch.manual_seed(0)
    return MSG3D(replace(TINY, **changes)).eval()


def _classifier(**changes: Any) -> VerbClassifier:
    nouns = NOUNS if changes else ()
    return VerbClassifier(_network(**changes), VERBS, nouns, SEQUENCE)


def test_a_card_says_everything_that_using_the_network_takes(tmp_path: Path) -> None:
    path, network = tmp_path / "net.safetensors", _network(num_frame_features=2)
    save_weights(path, network, {"data": "made up", **VerbClassifier.card(VERBS, NOUNS, SEQUENCE)})
    found = VerbClassifier.load(path)
    assert (found.verbs, found.nouns, found.sequence) == (VERBS, NOUNS, SEQUENCE)
    assert found.network.config == network.config and not found.network.training
    given = ["bolt"] * len(CLIPS)
    expected = VerbClassifier(network, VERBS, NOUNS, SEQUENCE).probabilities(CLIPS, given, 4, 1)
    np.testing.assert_array_equal(found.probabilities(CLIPS, given, 4, 1), expected)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "net.safetensors"
    save_weights(path, SVEgoNet(SVEgoNetConfig("mobilenetv3_small_050", 2, 8, image_size_px=64, num_depths=8)), {})
    with pytest.raises(ValueError, match=r"net.safetensors holds weights of SVEgoNet, not of MSG3D: give the right"):
        VerbClassifier.load(path)
    save_weights(path, _network(), {})
    with pytest.raises(ValueError, match=r"net.safetensors does not say which verbs it tells apart: train it with"):
        VerbClassifier.load(path)


def test_objects_are_one_hot_at_every_frame_and_unknown_ones_zeros() -> None:
    found = object_features(torch.tensor([1, UNKNOWN_NOUN, 0]), 2, 3)
    assert found is not None and found.dtype == torch.float32
    np.testing.assert_array_equal(found[:, 0], [[0, 1], [0, 0], [1, 0]])
    np.testing.assert_array_equal(found, found[:, :1].expand(-1, 3, -1))
    assert object_features(torch.tensor([0, UNKNOWN_NOUN]), 0, 3) is None


def test_probabilities_sum_to_one_whatever_the_batches_and_threads() -> None:
    classifier = _classifier()
    found = classifier.probabilities(CLIPS, [""] * 7, batch_size=7, num_threads=1)
    assert found.shape == (7, 3) and found.std(axis=0).min() > 1e-5
    np.testing.assert_allclose(found.sum(axis=1), 1.0, atol=1e-6)
    for batch_size, num_threads in ((1, 1), (3, 2), (100, 2)):
        other = classifier.probabilities(CLIPS, [""] * 7, batch_size, num_threads)
        np.testing.assert_allclose(other, found, rtol=0, atol=1e-5)
    assert classifier.probabilities([], [], 4, 1).shape == (0, 3)


def test_nouns_count_only_for_a_network_that_was_told_them() -> None:
    told, untold = _classifier(num_frame_features=2), _classifier()
    for nouns in (["bolt"], ["wheel"], ["anvil"]):
        found = told.probabilities(CLIPS[:1], nouns, 4, 1)
        weights = told.network.classifier.weight[:, -2:].detach().numpy()
        cue = weights[:, NOUNS.index(nouns[0])] if nouns[0] in NOUNS else np.zeros(3)
        without = np.log(told.probabilities(CLIPS[:1], ["anvil"], 4, 1)) + cue
        expected = np.exp(without) / np.exp(without).sum()
        np.testing.assert_allclose(found, expected, atol=1e-6)
        np.testing.assert_array_equal(
            untold.probabilities(CLIPS[:1], nouns, 4, 1), untold.probabilities(CLIPS[:1], [""], 4, 1)
        )


def test_clips_of_another_graph_are_refused() -> None:
    with pytest.raises(ValueError, match="the clip has nodes of the graph 'landmarks', the network takes 'skeleton'"):
        _classifier().probabilities([moving_clip("screw", 0, "landmarks")], [""], 4, 1)
