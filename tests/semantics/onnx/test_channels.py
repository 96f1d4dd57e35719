"""Networks with more channels give the same results."""

from importlib.resources import files

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from stillroom.semantics.onnx.channels import NARROW, WIDE, channels_of_a_block, widen
from stillroom.semantics.yolo_fastest import SHIPPED


def run(model, image):
    session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    return session.run(None, {session.get_inputs()[0].name: image})


def channels_of(model):
    """Return the channels of what each convolution makes, but for those at the end."""
    sizes = {constant.name: constant.dims for constant in model.graph.initializer}
    ends = {node.input[0] for node in model.graph.node if node.output[0] in {o.name for o in model.graph.output}}
    ends |= {output.name for output in model.graph.output}
    return [sizes[n.input[1]][0] for n in model.graph.node if n.op_type == "Conv" and n.output[0] not in ends]


@pytest.mark.parametrize("least", [NARROW, WIDE])
@pytest.mark.parametrize("variant", sorted(SHIPPED))
def test_the_shipped_networks_say_the_same(variant, least):
    plain = onnx.load(str(files("stillroom.semantics") / "weights" / SHIPPED[variant]))
    wide = onnx.ModelProto()
    wide.CopyFrom(plain)
    widen(wide, least)
    onnx.checker.check_model(wide)
    assert min(channels_of(plain)) < WIDE
    assert min(channels_of(wide)) >= least
    side = plain.graph.input[0].type.tensor_type.shape.dim[2].dim_value
    image = np.random.default_rng(0).uniform(0, 255, (1, 3, side, side)).astype(np.float32)
    for now, before in zip(run(wide, image), run(plain, image), strict=True):
        np.testing.assert_allclose(now, before, rtol=1e-3, atol=1e-3)


def small_network(middle="LeakyRelu", groups=6):
    """Return a network of 3 → 6 → 6 (in groups) channels, of both beside each other, and their mix."""
    rng = np.random.default_rng(1)
    shapes = {"a": (6, 3, 3, 3), "b": (6, 6 // groups, 3, 3), "c": (5, 12, 1, 1)}
    constants = [numpy_helper.from_array(rng.normal(size=s).astype(np.float32), f"w{k}") for k, s in shapes.items()]
    constants += [numpy_helper.from_array(rng.normal(size=s[0]).astype(np.float32), f"b{k}") for k, s in shapes.items()]
    nodes = [
        helper.make_node("Conv", ["image", "wa", "ba"], ["a"], pads=[1, 1, 1, 1]),
        helper.make_node(middle, ["a"], ["m"]),
        helper.make_node("Conv", ["m", "wb", "bb"], ["b"], pads=[1, 1, 1, 1], group=groups),
        helper.make_node("Add", ["b", "m"], ["s"]),
        helper.make_node("Concat", ["s", "m"], ["d"], axis=1),
        helper.make_node("Conv", ["d", "wc", "bc"], ["end"]),
    ]
    image, end = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, n, 9, 7]) for name, n in (("image", 3), ("end", 5))
    )
    graph = helper.make_graph(nodes, "small", [image], [end], constants)
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)


def test_what_is_put_beside_each_other_and_added_up_keeps_its_places():
    plain, wide = small_network(), small_network()
    widen(wide, WIDE)
    assert channels_of(wide) == [WIDE, WIDE]
    image = np.random.default_rng(2).normal(size=(1, 3, 9, 7)).astype(np.float32)
    np.testing.assert_allclose(run(wide, image)[0], run(plain, image)[0], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("changes", [{"middle": "Exp"}, {"groups": 2}])
def test_a_network_with_a_step_that_is_not_known_stays_as_it_is(changes):
    plain, wide = small_network(**changes), small_network(**changes)
    widen(wide, WIDE)
    assert wide == plain


@pytest.mark.parametrize(
    ("features", "expected"), [({"avx512f": True}, WIDE), ({"avx512f": False}, NARROW), ({"neon": True}, NARROW)]
)
def test_blocks_are_as_wide_as_the_registers(monkeypatch, features, expected):
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_features", lambda: features)
    assert channels_of_a_block() == expected
