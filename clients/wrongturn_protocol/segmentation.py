"""The classes of a segmentation image."""

from enum import IntEnum


class SegmentationClass(IntEnum):
    """What a pixel shows. The numbers are the values in the ``segmentation`` observation."""

    VOID = 0
    ROAD = 1
    LANE_MARKING = 2
    SIDEWALK = 3
    VEGETATION = 4
    """Trees and hedges, and the ground beside the road."""
    BUILDING = 5
    WALL = 6
    """Walls, fences and barriers."""
    VEHICLE = 7
    PEDESTRIAN = 8
    TRAFFIC_SIGN = 9
    """Traffic lights and signs."""
    SKY = 10
