"""Networks by name."""

from stillroom.errors import ConfigError
from stillroom_train.pspnet.networks.mobilenet import pspnet_mobilenetv2
from stillroom_train.pspnet.networks.resnet import pspnet_resnet50
from stillroom_train.pspnet.networks.steps import Architecture

ARCHITECTURES = {"mobilenetv2": pspnet_mobilenetv2, "resnet50": pspnet_resnet50}


def architecture(backbone: str) -> Architecture:
    """Return PSPNet on a backbone.

    Raises:
        ConfigError: There is no such backbone.
    """
    if backbone not in ARCHITECTURES:
        raise ConfigError(f"backbone is '{backbone}'; known: {', '.join(ARCHITECTURES)}")
    return ARCHITECTURES[backbone]()
