"""Stillroom: where a camera was in a room full of people, and a map of what stays.

::

    import stillroom as sr

    dataset = sr.open_dataset("rgbd_bonn_crowd")
    with sr.Slam("oc-slam", dataset.camera) as slam:
        for image in dataset:
            result = slam.process(image)
    slam.trajectory().write_tum("trajectory.tum")

Names are loaded when they are first used (`__init__.pyi` lists them); importing the package changes nothing in the
process.
"""

import lazy_loader

from stillroom.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
