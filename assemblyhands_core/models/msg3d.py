"""MS-G3D: the joints of two hands over time in, what they are doing out.

Source: Liu et al., "Disentangling and unifying graph convolutions for skeleton-based action recognition" (CVPR 2020),
Sec. 3.4 and Fig. 3; paper, Sec. 5 (verbs from 42 joints) and supplement ("Object cues").
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from assemblyhands_core.hands.graphs import EDGES, GraphName, adjacency
from assemblyhands_core.hands.joints import NUM_JOINTS
from assemblyhands_core.models.msg3d_blocks import GraphConvolution, TemporalConvolutions, WindowGraphConvolution

WINDOWS: Final = (3, 5)
_NUM_AXES: Final = 3


@dataclass(frozen=True)
class MSG3DConfig:
    """What determines the network's shape.

    Attributes:
        num_classes: Verbs to tell apart.
        num_gcn_scales: Scales of the graph convolutions of single frames.
        num_g3d_scales: Scales of those of windows.
        c1: Channels after the first block, a multiple of six, as all.
        c2: Channels after the second one, at half of the frames.
        c3: Channels after the third one, at a quarter of them.
        graph: What the nodes are and which are joined, see `hands.graphs`.
        num_persons: Bodies that are pooled into one answer: the two hands.
        dropout: Probability of each pooled channel to be left out in training.
        num_frame_features: Further features of each frame, as a one-hot object label; 0 without.
    """

    num_classes: int
    num_gcn_scales: int
    num_g3d_scales: int
    c1: int
    c2: int
    c3: int
    graph: GraphName = "skeleton"
    num_persons: int = 2
    dropout: float = 0.0
    num_frame_features: int = 0


BASE: Final = MSG3DConfig(num_classes=6, num_gcn_scales=13, num_g3d_scales=6, c1=96, c2=192, c3=384)
SMALL: Final = MSG3DConfig(num_classes=6, num_gcn_scales=3, num_g3d_scales=2, c1=24, c2=48, c3=96)


class MSG3D(nn.Module):
    """The verb classifier.

    Features of frames join the pooled features of the hands as their mean over the frames. What reads them is linear,
    so that this is the mean of what each frame's features say, whatever the number of frames is; they cannot take part
    in what is learnt of poses, cost nothing, and an uninformative label can only be ignored.

    Args:
        config: `SMALL` for laptops, `BASE` for the published size, or one's own.
    """

    def __init__(self, config: MSG3DConfig) -> None:
        super().__init__()
        self.config = config
        is_joined = adjacency(EDGES[config.graph])
        self.input_norm = nn.BatchNorm1d(config.num_persons * NUM_JOINTS * _NUM_AXES)
        self.blocks = nn.Sequential(
            Block(_NUM_AXES, config.c1, config.c1, is_joined, config, stride=1),
            Block(config.c1, config.c1, config.c2, is_joined, config, stride=2),
            Block(config.c2, config.c2, config.c3, is_joined, config, stride=2),
        )
        self.dropout = nn.Dropout(config.dropout)
        self.classifier = nn.Linear(config.c3 + config.num_frame_features, config.num_classes)

    def forward(
        self,
        poses: Float[Tensor, "sample 3 frame joint=21 hand"],
        frame_features: Float[Tensor, "sample frame feature"] | None = None,
    ) -> Float[Tensor, "sample class"]:
        """Return logits.

        Args:
            poses: Nodes of the config's graph, in any unit and frame that training used; finite, zero where padded.
            frame_features: As many as the config says; not needed if there are none.

        Raises:
            ValueError: Frame features are missing, or there are some that the config does not know of.
        """
        found = 0 if frame_features is None else frame_features.shape[-1]
        if found != self.config.num_frame_features:
            raise ValueError(
                f"There are {found} features of each frame and the network takes {self.config.num_frame_features}: "
                "give those it was trained with."
            )
        features = self.blocks(self._normed(poses)).mean(dim=(1, 2))
        pooled = self.dropout(features.view(len(poses), -1, self.config.c3).mean(dim=1))
        if frame_features is not None:
            pooled = torch.cat((pooled, frame_features.mean(dim=1)), dim=1)
        logits: Tensor = self.classifier(pooled)
        return logits

    def _normed(
        self, poses: Float[Tensor, "sample 3 frame joint hand"]
    ) -> Float[Tensor, "sample_hand frame joint channel"]:
        """Return hands by themselves, every coordinate of every joint normalised over samples and frames."""
        samples, axes, frames, joints, hands = poses.shape
        rows = poses.permute(0, 4, 3, 1, 2).reshape(samples, hands * joints * axes, frames)
        normed = self.input_norm(rows).view(samples * hands, joints, axes, frames)
        channels_last: Tensor = normed.permute(0, 3, 1, 2).contiguous()
        return channels_last


class Block(nn.Module):
    """Two pathways side by side, single frames over many scales and windows over few, and temporal convolutions.

    Args:
        num_inputs: Channels of each joint.
        width: Channels of the graph convolutions.
        num_outputs: Channels after it.
        is_joined: The graph of one frame.
        config: The numbers of scales.
        stride: Frames from one to the next.

    Source: MS-G3D, Fig. 3(b).
    """

    def __init__(
        self,
        num_inputs: int,
        width: int,
        num_outputs: int,
        is_joined: Bool[np.ndarray, "joint joint"],
        config: MSG3DConfig,
        stride: int,
    ) -> None:
        super().__init__()
        scales = config.num_g3d_scales
        self.windows = nn.ModuleList(
            WindowGraphConvolution(num_inputs, width, num_outputs, is_joined, scales, window, stride)
            for window in WINDOWS
        )
        self.graph = GraphConvolution(num_inputs, width, is_joined, config.num_gcn_scales)
        self.inner = nn.Sequential(
            TemporalConvolutions(width, num_outputs, stride),
            TemporalConvolutions(num_outputs, num_outputs, has_relu=False),
        )
        self.last = TemporalConvolutions(num_outputs, num_outputs)

    def forward(self, x: Float[Tensor, "hand frame joint input"]) -> Float[Tensor, "hand later_frame joint output"]:
        """Return every `stride`-th frame."""
        added = self.inner(self.graph(x).squeeze(3))
        for window in self.windows:
            added = added + window(x)
        after: Tensor = self.last(added.relu())
        return after
