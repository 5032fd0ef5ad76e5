"""A recording session: who works with what in front of which rig, filmed frame by frame."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
import pyarrow as pa
from jaxtyping import UInt8

from assemblyhands_core.data.ground_truth import TrueInstant
from assemblyhands_core.data.names import parse_recording_name
from assemblyhands_core.hands.joints import HANDS, NUM_JOINTS
from assemblyhands_core.synthetic.figure import JOINT_OWNERS
from assemblyhands_core.synthetic.render import BackgroundCache, Sensor, render, visibility
from assemblyhands_core.synthetic.rig import RIGS, Rig, RigKind
from assemblyhands_core.synthetic.scene import Studio
from assemblyhands_core.synthetic.take import State, Take
from assemblyhands_core.synthetic.toys import SetKind

RATE_HZ: Final = 30
"""Frames a second of the studio's videos, unless ordered otherwise."""


@dataclass(frozen=True)
class Order:
    """What is to be recorded; every seed follows from it.

    Attributes:
        recording: Its name, which says who (a participant is always the same person), on which day (cameras are
            calibrated once a day), and, by all of its letters, what happens.
        rig: In front of which cameras.
        duration_s: For how long.
        rate_hz: Frames a second; fewer than `RATE_HZ` show more of what happens in as many pictures.

    Raises:
        ValueError: The name is not of the data set's pattern.
    """

    recording: str
    rig: RigKind
    duration_s: float
    rate_hz: int = RATE_HZ

    @staticmethod
    def of(takes: pa.Table) -> "Order":
        """Return the one row of a `studio_tables.TAKES` table."""
        (row,) = takes.to_pylist()
        return Order(row["sequence_id"], row["rig"], row["duration_s"], row["rate_hz"])

    def __post_init__(self) -> None:
        """Refuse a name that tells nobody who is recorded."""
        parse_recording_name(self.recording)

    @property
    def num_frames(self) -> int:
        """Return the length of the videos."""
        return max(1, round(self.duration_s * self.rate_hz))

    def write_take(self) -> Take:
        """Write the script of what happens."""
        name = parse_recording_name(self.recording)
        return Take.from_seed(name.participant, zlib.crc32(self.recording.encode()), self.duration_s, self.things)

    @property
    def things(self) -> SetKind:
        """Return which things lie on the table: those of the desktop rig are seen in front of no other."""
        return "desktop" if self.rig == "desktop" else "assembly"

    def build_rig(self) -> Rig:
        """Return the cameras of the day."""
        return RIGS[self.rig](parse_recording_name(self.recording).day_seed)


@dataclass(frozen=True, eq=False)
class Shot:
    """One instant as all cameras see it.

    Attributes:
        images: Camera → picture, RGB, or grey from the headset.
        state: What happens.
        truth: What evaluation is to know.
    """

    images: Mapping[str, UInt8[np.ndarray, "height width *channel"]]
    state: State
    truth: TrueInstant


class Session:
    """The studio during one recording; any frame may be filmed at any time and is always the same."""

    def __init__(self, order: Order) -> None:
        """Set up take, room and cameras."""
        self.rig, self.rate_hz = order.build_rig(), order.rate_hz
        self.take = order.write_take()
        self._studio = Studio.of(self.take)
        day_seed = parse_recording_name(order.recording).day_seed
        ids = {**dict.fromkeys(self.rig.exo, False), **dict.fromkeys(self.rig.ego, True)}
        self._sensors = {name: Sensor.from_seed(day_seed, name, is_mono=is_ego) for name, is_ego in ids.items()}
        self._cache = BackgroundCache()

    @property
    def camera_ids(self) -> tuple[str, ...]:
        """Return the names of all cameras, those that stand still first."""
        return tuple(self._sensors)

    def shoot(self, frame: int) -> Shot:
        """Film one frame with all cameras."""
        state = self.take.state_at(frame / self.rate_hz)
        scene, cameras = self._studio.scene(state), self.rig.cameras_at(state.T_headset_from_world)
        images = {
            name: render(
                scene,
                camera,
                sensor=self._sensors[name],
                frame_seed=frame,
                background_cache=self._cache,
                is_fixed=name in self.rig.exo,
            ).image
            for name, camera in cameras.items()
        }
        is_seen = visibility(
            scene, list(cameras.values()), state.joints_world_mm, JOINT_OWNERS, background_cache=self._cache
        ).reshape(-1, len(HANDS), NUM_JOINTS)
        verb, noun = state.action
        truth = TrueInstant(
            frame=frame,
            joints_world_mm=state.joints_world_mm.reshape(len(HANDS), NUM_JOINTS, 3),
            cameras=cameras,
            is_unoccluded=dict(zip(cameras, is_seen, strict=True)),
            T_headset_from_world=state.T_headset_from_world if self.rig.ego else None,
            verb=verb,
            noun=noun,
        )
        return Shot(images, state, truth)
