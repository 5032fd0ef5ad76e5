"""What each network is to learn from crops of hands, and by what it is judged."""

from typing import Final

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from assemblyhands_core.hands.joints import NUM_JOINTS, WRIST
from assemblyhands_core.models.hand_keypoints import HandKeypointNet, KeypointEstimate
from assemblyhands_core.models.msg3d import MSG3D
from assemblyhands_core.models.mvexonet import HandEstimate, MVExoNet
from assemblyhands_core.models.svegonet import SVEgoNet
from assemblyhands_core.models.verb_classification import object_features
from assemblyhands_core.training.loop import Batch, Samples, Task

_NEAR: Final = 1e-6  # of a depth, so that what is behind a camera divides by something


def keypoint_task(network: HandKeypointNet, training: Samples, held_out: Samples) -> Task:
    """Return the 2D network's task: joints in single views, judged in pixels of the crop."""
    size_px = network.config.image_size_px

    def loss(batch: Batch) -> Tensor:
        images, pixels, is_valid, is_left = used_views(batch, size_px)
        return network.loss(network(images, is_left), pixels, is_valid, is_left)

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        images, pixels, is_valid, is_left = used_views(batch, size_px)
        return mean_distance(network(images, is_left).pixels, pixels, is_valid)

    return Task(network, loss, error, training, held_out)


def body_task(network: HandKeypointNet, training: Samples, held_out: Samples) -> Task:
    """Return the body network's task: keypoints in whole pictures, judged in their pixels."""

    def estimate(batch: Batch) -> tuple[KeypointEstimate, Tensor]:
        is_left = torch.zeros(len(batch["images"]), dtype=torch.bool, device=batch["images"].device)
        return network(images_of(batch), is_left), is_left

    def loss(batch: Batch) -> Tensor:
        found, is_left = estimate(batch)
        return network.loss(found, batch["pixels"], batch["is_valid"], is_left)

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        return mean_distance(estimate(batch)[0].pixels, batch["pixels"], batch["is_valid"])

    return Task(network, loss, error, training, held_out)


def mvexonet_task(network: MVExoNet, training: Samples, held_out: Samples) -> Task:
    """Return MVExoNet's task: joints of hands seen by several views, judged in mm."""

    def estimate(batch: Batch) -> HandEstimate:
        names = ("P_pixel_from_world", "is_view_used", "root_world_mm", "is_left")
        return network(images_of(batch), *(batch[name] for name in names))  # type: ignore[no-any-return]

    def loss(batch: Batch) -> Tensor:
        names = ("joints_world_mm", "is_valid", "root_world_mm", "is_left")
        return network.loss(estimate(batch), *(batch[name] for name in names))

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        return mean_distance(estimate(batch).joints_world_mm, batch["joints_world_mm"], batch["is_valid"])

    return Task(network, loss, error, training, held_out)


def ego_task(network: SVEgoNet, training: Samples, held_out: Samples) -> Task:
    """Return SVEgoNet's task, judged by the wrist-relative error in mm of the crop's own hand, wrists' depth known."""

    def loss(batch: Batch) -> Tensor:
        names = ("pixels", "depth_mm", "is_valid", "identity")
        return network.loss(network(images_of(batch)), *(batch[name] for name in names))

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        found = network(images_of(batch))
        # No matrix product, see `used_views`.
        rays = torch.nn.functional.pad(found.pixels, (0, 1), value=1.0)[:, :, None] * batch["ray_from_pixel"][:, None]
        joints = rays.sum(dim=-1) * (found.depth_mm + batch["wrist_depth_mm"])[..., None]
        relative = (_from_wrist(joints), _from_wrist(batch["joints_camera_mm"]))
        return mean_distance(*relative, batch["is_valid"] & batch["is_own"])

    return Task(network, loss, error, training, held_out)


def verb_task(network: MSG3D, training: Samples, held_out: Samples) -> Task:
    """Return MS-G3D's task: the verb of a clip of poses, judged by the share of wrong answers in percent."""

    def logits(batch: Batch) -> Tensor:
        told = object_features(batch["noun"], network.config.num_frame_features, batch["poses"].shape[2])
        return network(batch["poses"], told)  # type: ignore[no-any-return]

    def loss(batch: Batch) -> Tensor:
        return torch.nn.functional.cross_entropy(logits(batch), batch["verb"])

    def error(batch: Batch) -> tuple[Tensor, Tensor]:
        is_wrong = logits(batch).argmax(dim=-1) != batch["verb"]
        return 100.0 * is_wrong.float().mean(), torch.tensor(len(is_wrong), device=is_wrong.device)

    return Task(network, loss, error, training, held_out)


def _from_wrist(joints_mm: Float[Tensor, "batch joint=42 3"]) -> Float[Tensor, "batch joint=42 3"]:
    hands = joints_mm.view(len(joints_mm), -1, NUM_JOINTS, 3)
    relative: Tensor = hands - hands[:, :, WRIST, None]
    return relative.flatten(1, 2)


def images_of(batch: Batch) -> Float[Tensor, "batch *view 3 height width"]:
    """Return a batch's pictures as networks take them: RGB in [0, 1], channels first."""
    return batch["images"].movedim(-1, -3).float() / 255.0


def used_views(
    batch: Batch, size_px: int
) -> tuple[
    Float[Tensor, "used 3 size size"], Float[Tensor, "used joint 2"], Bool[Tensor, "used joint"], Bool[Tensor, " used"]
]:
    """Return pictures, true pixels, which of them count, and the side, for each view that is used.

    A joint counts where it lies in the picture, hidden or not.
    """
    used = batch["is_view_used"]
    points = torch.nn.functional.pad(batch["joints_world_mm"], (0, 1), value=1.0)
    matrices = batch["P_pixel_from_world"]
    # No matrix product: mixed precision would do it in bfloat16, which is whole pixels off.
    projected = (matrices[:, :, None] * points[:, None, :, None]).sum(dim=-1)[used]
    pixels = projected[..., :2] / projected[..., 2:].clamp(min=_NEAR)
    inside = ((pixels > -0.5) & (pixels < size_px - 0.5)).all(dim=-1) & (projected[..., 2] > 0)
    is_valid = batch["is_valid"][:, None].expand(-1, used.shape[1], -1)[used] & inside
    is_left = batch["is_left"][:, None].expand(-1, used.shape[1])[used]
    return images_of(batch)[used], torch.where(inside[..., None], pixels, 0.0), is_valid, is_left


def mean_distance(
    found: Float[Tensor, "item joint dim"], true: Float[Tensor, "item joint dim"], is_valid: Bool[Tensor, "item joint"]
) -> tuple[Float[Tensor, ""], Tensor]:
    """Return the mean distance of valid joints, and how many they are."""
    distances = torch.linalg.vector_norm(found - true, dim=-1)
    return distances[is_valid].mean() if is_valid.any() else distances.new_zeros(()), is_valid.sum()
