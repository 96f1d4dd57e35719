"""Networks with random weights, and what an ONNX model says."""

import numpy as np

from stillroom.geometry.arrays import F32
from stillroom_train.pspnet.networks.registry import architecture


def random_weights(backbone: str) -> dict[str, F32]:
    """Weights that keep values alive through all layers, so that nothing that is wrong is hidden by zeros."""
    lot = np.random.default_rng(5)
    found: dict[str, F32] = {}
    for name, shape in architecture(backbone).shapes().items():
        if name.endswith("running_var"):
            found[name] = lot.uniform(0.5, 2.0, shape).astype(np.float32)
        elif len(shape) == 4:
            found[name] = (lot.normal(0.0, 1.0, shape) * np.sqrt(2.0 / np.prod(shape[1:]))).astype(np.float32)
        else:
            found[name] = (
                lot.uniform(0.5, 1.0, shape) if name.endswith("weight") else lot.normal(0.0, 0.1, shape)
            ).astype(np.float32)
    return found


def run_onnx(model: object, image: F32) -> F32:
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(model.SerializeToString(), options, providers=["CPUExecutionProvider"])
    return session.run(["logits"], {"image": image})[0]
