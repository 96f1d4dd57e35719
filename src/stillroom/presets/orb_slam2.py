"""ORB-SLAM2's RGB-D system: it assumes a static world. The baseline of the others."""

from stillroom.config import SlamConfig
from stillroom.presets.method import Method

METHOD = Method(
    name="orb-slam2",
    summary="nothing is rejected: the world is assumed to be static",
    config=SlamConfig(method="orb-slam2"),
    paper="Mur-Artal and Tardós, IEEE Transactions on Robotics 33(5), 2017",
)
