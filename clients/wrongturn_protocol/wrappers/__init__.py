"""Gymnasium wrappers for what people change about an environment: its actions, its observations, its reward.

They wrap the environments in process and over the wire alike. Most derive from Gymnasium's ``TransformObservation`` and
``TransformAction``, so ``gymnasium.wrappers.vector`` can apply them to a whole batch.
"""

from wrongturn_protocol.wrappers.actions import DiscreteActions, SteerAndPedal
from wrongturn_protocol.wrappers.agent import WrappedAgent
from wrongturn_protocol.wrappers.car_frame import CarFrame
from wrongturn_protocol.wrappers.pictures import (
    GrayPicture,
    OnlyPicture,
    ResizePictures,
    SegmentationPlanes,
    StackPictures,
)
from wrongturn_protocol.wrappers.reward import ShapeReward

__all__ = [
    "CarFrame",
    "DiscreteActions",
    "GrayPicture",
    "OnlyPicture",
    "ResizePictures",
    "SegmentationPlanes",
    "ShapeReward",
    "StackPictures",
    "SteerAndPedal",
    "WrappedAgent",
]
