"""What stages share that make egocentric crops, of recordings or drawn ones."""

from pydantic import Field

from assemblyhands_core.data.ego_boxes import EgoRule
from assemblyhands_core.hands.joints import NUM_JOINTS
from stages._contract import StageConfig


class EgoCropsConfig(StageConfig):
    """Which crops are made, and how they are stored."""

    gamma: float = Field(ge=1, le=6)
    size_px: int = Field(ge=32, le=2048)
    jpeg_quality: int = Field(ge=1, le=100)
    min_joints: int = Field(ge=1, le=NUM_JOINTS)
    min_border_px: float
    min_other_share: float = Field(gt=0, le=1)

    def rule(self) -> EgoRule:
        """Return which crops are made."""
        return EgoRule(self.gamma, self.min_joints, self.min_border_px, self.min_other_share)
