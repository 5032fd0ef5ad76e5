"""Clips of poses to verbs with a frozen MS-G3D, batch by batch."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32, Int
from torch import Tensor
from torch.nn.functional import one_hot

from assemblyhands_core.data.json_files import FormatError, json_list, json_object, kind_of, member
from assemblyhands_core.data.pose_clips import PoseClip
from assemblyhands_core.data.pose_sequences import PoseSequenceConfig, sequence_of
from assemblyhands_core.data.verb_segments import UNKNOWN_NOUN
from assemblyhands_core.models.msg3d import MSG3D
from assemblyhands_core.models.pretrained import load_msg3d
from assemblyhands_core.models.weights_files import card_entry, checked_config, read_card


def object_features(
    noun: Int[Tensor, " sample"], num_nouns: int, num_frames: int
) -> Float[Tensor, "sample frame noun"] | None:
    """Return the one-hot label of each sample's object at every frame (supplement, "Object cues"); None without any.

    Args:
        noun: Its place among those that the network knows, `UNKNOWN_NOUN` for another one.
        num_nouns: How many it knows.
        num_frames: Of the samples.
    """
    if not num_nouns:
        return None
    places = torch.where(noun == UNKNOWN_NOUN, num_nouns, noun)
    return one_hot(places, num_nouns + 1)[:, None, :num_nouns].expand(-1, num_frames, -1).float()


@dataclass(frozen=True, eq=False)
class VerbClassifier:
    """A network with what it was trained for.

    Attributes:
        network: For evaluation.
        verbs: Its classes.
        nouns: Objects that it can be told; none if it looks at poses alone.
        sequence: How clips become its input.
    """

    network: MSG3D
    verbs: tuple[str, ...]
    nouns: tuple[str, ...]
    sequence: PoseSequenceConfig

    @staticmethod
    def load(path: Path) -> "VerbClassifier":
        """Read a weights file that `train_verbs` wrote.

        Raises:
            ValueError: The file is of another network, or does not say what its classes are.
        """
        network, card = load_msg3d(path), read_card(path)
        if "classifier" not in card:
            raise ValueError(f"{path} does not say which verbs it tells apart: train it with target=train_verbs.")
        said = card_entry(card, "classifier", path)
        verbs, nouns = (_names(member(said, key, str(path)), f"{path}: its {key}") for key in ("verbs", "nouns"))
        sequence = json_object(member(said, "sequence", str(path)), f"{path}: its sequence")
        if "hands" in sequence:
            sequence["hands"] = _names(sequence["hands"], f"{path}: its hands")
        shape = network.config.num_classes, network.config.num_frame_features
        if (len(verbs), len(nouns)) != shape:
            raise FormatError(f"{path}: names {len(verbs)} verbs and {len(nouns)} nouns, its network has {shape}.")
        return VerbClassifier(network, verbs, nouns, checked_config(PoseSequenceConfig, sequence, str(path)))

    @staticmethod
    def card(verbs: tuple[str, ...], nouns: tuple[str, ...], sequence: PoseSequenceConfig) -> dict[str, str]:
        """Return what a weights file has to say besides the network's own shape."""
        said = {"verbs": verbs, "nouns": nouns, "sequence": asdict(sequence)}
        return {"classifier": json.dumps(said, sort_keys=True)}

    def probabilities(
        self, clips: Sequence[PoseClip], nouns: Sequence[str], batch_size: int, num_threads: int
    ) -> Float32[np.ndarray, "clip verb"]:
        """Return how probable each verb is; on a CPU batches run side by side, each on one thread.

        Args:
            clips: Segments with their context; a hand that is never seen counts as zeros.
            nouns: With what each is done; one that the network was not told in training counts as unknown.
            batch_size: Clips at a time.
            num_threads: Of the CPU.
        """
        torch.set_num_threads(1)
        device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        network = self.network.to(device)
        found = np.empty((len(clips), len(self.verbs)), dtype=np.float32)

        def classify(part: slice) -> None:
            poses = torch.from_numpy(np.stack([sequence_of(clip, self.sequence).values for clip in clips[part]]))
            places = torch.tensor([self.nouns.index(n) if n in self.nouns else UNKNOWN_NOUN for n in nouns[part]])
            with torch.inference_mode():
                objects = object_features(places.to(device), len(self.nouns), poses.shape[2])
                found[part] = network(poses.to(device), objects).softmax(dim=-1).cpu().numpy()

        with ThreadPoolExecutor(1 if device.type == "cuda" else num_threads) as threads:
            list(
                threads.map(classify, [slice(first, first + batch_size) for first in range(0, len(clips), batch_size)])
            )
        return found


def _names(value: object, where: str) -> tuple[str, ...]:
    names = tuple(json_list(value, where))
    if odd := [name for name in names if not isinstance(name, str)]:
        raise FormatError(f"{where}: {kind_of(odd[0])} is no name; get the file again.")
    return names
