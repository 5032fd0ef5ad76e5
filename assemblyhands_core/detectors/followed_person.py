"""Of all bodies detected in all views, the keypoints of the one person that is followed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Shaped

from assemblyhands_core.detectors.base import BODY_MIRROR
from assemblyhands_core.detectors.bodies import BodiesInViews
from assemblyhands_core.geometry.association import associate_persons, follow_person
from assemblyhands_core.geometry.cameras import Camera


@dataclass(frozen=True, eq=False)
class PersonInViews:
    """One person in some frames of all views, left being left in all of them.

    Attributes:
        keypoints_px: COCO-17 order, pixels of the view's video; NaN = missing.
        confidence: in 0..1; 0 = missing.
        reason: texts, why a view does not see the person: as in ``BodiesInViews``, or ``not_associated`` (it
            sees persons, none of whom fits what the other views see); empty where it does.
        num_persons: the most persons that the views agree on in any frame.
        sentence: who was followed and why, for the user.
    """

    keypoints_px: Float64[np.ndarray, "frame view keypoint=17 2"]
    confidence: Float64[np.ndarray, "frame view keypoint=17"]
    reason: Shaped[np.ndarray, "frame view"]
    num_persons: int
    sentence: str

    @property
    def is_seen(self) -> Bool[np.ndarray, "frame view"]:
        """Return whether the view sees the person."""
        return np.asarray(self.reason == "", dtype=np.bool_)


def follow_in_views(
    found: BodiesInViews, cameras: Sequence[Camera], *, max_reprojection_px: float, max_persons: int
) -> PersonInViews:
    """Tell the persons apart across views, choose the one to follow and return that one's keypoints.

    Args:
        found: bodies in the frames of all views.
        cameras: one for each view.
        max_reprojection_px: keypoints of one person agree across views within this distance.
        max_persons: persons told apart.
    """
    persons = associate_persons(
        found.keypoints_px,
        found.confidence,
        cameras,
        max_reprojection_px=max_reprojection_px,
        max_persons=max_persons,
        mirror=BODY_MIRROR,
    )
    followed = follow_person(persons, cameras, mirror=BODY_MIRROR)
    keypoints_px, confidence = followed.select(found.keypoints_px, found.confidence, BODY_MIRROR)
    is_other = (followed.person_index < 0) & (found.reason == "")
    return PersonInViews(
        keypoints_px,
        confidence,
        np.where(is_other, "not_associated", found.reason),
        int((persons.num_views > 0).sum(axis=1).max(initial=0)),
        followed.sentence,
    )
