"""Ask two other runtimes what YOLO-Fastest sees, and write `yolo_fastest_boxes.json`.

Nothing here is shared with the package: OpenCV 4 reads darknet's files itself, and for ncnn this script writes the
network layer by layer, batch normalisation unfolded, from the cfg and weights' own numbers.

    python -m venv /tmp/opencv4 && /tmp/opencv4/bin/pip install "opencv-python-headless<5" ncnn
    /tmp/opencv4/bin/python tests/golden/make_yolo_fastest_boxes.py "$STILLROOM_DATA" "$STILLROOM_MODELS"/yolo_fastest
"""

import json
import math
import struct
import sys
import tempfile
from pathlib import Path

import cv2
import ncnn
import numpy as np

PICTURES = (
    "rgbd_bonn_crowd_first560/rgb/1548339833.28164.jpg",
    "rgbd_bonn_crowd_first560/rgb/1548339835.96220.jpg",
    "rgbd_bonn_crowd_first560/rgb/1548339837.97401.jpg",
    "person_masks/images/pennfudan_PennPed00095.jpg",
    "person_masks/images/hsd_10.jpg",
)
CONFIDENCE, NMS_IOU, SIDE = 0.3, 0.45, 320


def ask_opencv(cfg, weights, image_bgr):
    """Rows (N, 85): centre, size in [0, 1], objectness, objectness × class probability."""
    network = cv2.dnn.readNetFromDarknet(str(cfg), str(weights))
    blob = cv2.dnn.blobFromImage(image_bgr, 1 / 255.0, (SIDE, SIDE), swapRB=True, crop=False)
    network.setInput(blob)
    return np.concatenate(network.forward(network.getUnconnectedOutLayersNames()))


def read_sections(cfg):
    sections = []
    for line in cfg.read_text().splitlines():
        line = line.split("#")[0].strip()
        if line.startswith("["):
            sections.append((line[1:-1], {}))
        elif line:
            key, value = line.split("=")
            sections[-1][1][key.strip()] = value.strip()
    return sections[1:]


def write_ncnn(cfg, weights, folder):
    """Write net.param and net.bin; return the names of the two raw outputs with their anchors."""
    content = weights.read_bytes()
    numbers = iter(np.frombuffer(content[20:], "<f4"))  # header: three int32, one int64

    def take(n):
        return np.array([next(numbers) for _ in range(n)], "<f4")

    lines, binary, outputs, heads = [], b"", [], []  # a line: kind, inputs, output, parameters

    def emit(kind, inputs, name, parameters=""):
        lines.append((kind, inputs, name, parameters))
        return name

    channels = {"in": 3}
    for index, (kind, options) in enumerate(read_sections(cfg)):
        last = outputs[-1] if outputs else "in"
        out = f"l{index}"
        if kind == "convolutional":
            n, size = int(options["filters"]), int(options["size"])
            groups, normalised = int(options.get("groups", 1)), "batch_normalize" in options
            depth = channels[last] // groups
            bias = take(n)
            scale, mean, variance = (take(n), take(n), take(n)) if normalised else (None, None, None)
            kernel = take(n * depth * size * size)
            padding = size // 2 if options["pad"] == "1" else 0
            text = f"0={n} 1={size} 3={options['stride']} 4={padding} 5={int(not normalised)} 6={kernel.size}"
            conv = "ConvolutionDepthWise" if groups > 1 else "Convolution"
            text += f" 7={groups}" if groups > 1 else ""
            binary += struct.pack("<i", 0) + kernel.tobytes()
            name = emit(conv, [last], f"{out}c", text)
            if normalised:
                name = emit("BatchNorm", [name], f"{out}n", f"0={n} 1=1e-5")
                binary += scale.tobytes() + mean.tobytes() + variance.tobytes() + bias.tobytes()
            else:
                binary += bias.tobytes()
            if options["activation"] == "leaky":
                name = emit("ReLU", [name], f"{out}a", "0=0.1")
            channels[name] = n
        elif kind == "maxpool":
            size = int(options["size"])
            text = f"0=0 1={size} 2={options['stride']} 3={size // 2} 5=1"
            name = emit("Pooling", [last], out, text)
            channels[name] = channels[last]
        elif kind == "route":
            which = [int(word) for word in options["layers"].split(",")]
            sources = [outputs[k] for k in which]  # negative ones count from the end, as Python does
            name = sources[0] if len(sources) == 1 else emit("Concat", sources, out, "0=0")
            channels[name] = sum(channels[source] for source in sources)
        elif kind == "shortcut":
            name = emit("BinaryOp", [last, outputs[int(options["from"])]], out, "0=0")
            channels[name] = channels[last]
        elif kind == "upsample":
            name = emit("Interp", [last], out, f"0=1 1={options['stride']}.0 2={options['stride']}.0")
            channels[name] = channels[last]
        elif kind == "yolo":
            pairs = np.array([float(w) for w in options["anchors"].split(",")]).reshape(-1, 2)
            heads.append((last, pairs[[int(w) for w in options["mask"].split(",")]]))
            name = last
        else:
            assert kind == "dropout", kind
            name = last
        outputs.append(name)
    assert next(numbers, None) is None, "numbers left over"
    (folder / "net.param").write_text(split_and_join(lines))
    (folder / "net.bin").write_bytes(binary)
    return heads


def split_and_join(lines):
    """Write ncnn's text; a blob that is read n times goes through a Split of n outputs."""
    readers = {}
    for _, inputs, _, _ in lines:
        for name in inputs:
            readers[name] = readers.get(name, 0) + 1
    copies, rows, blobs = {}, [], 0
    for kind, inputs, out, parameters in [("Input", [], "in", ""), *lines]:
        names = [copies[name].pop() if name in copies else name for name in inputs]
        rows.append(f"{kind} {out}_layer {len(names)} 1 {' '.join([*names, out])} {parameters}")
        blobs += 1
        if readers.get(out, 0) > 1:
            copies[out] = [f"{out}_s{k}" for k in range(readers[out])]
            rows.append(f"Split {out}_split 1 {readers[out]} {out} {' '.join(copies[out])}")
            blobs += readers[out]
    return f"7767517\n{len(rows)} {blobs}\n" + "\n".join(rows) + "\n"


def ask_ncnn(cfg, weights, image_bgr):
    """The same rows as OpenCV gives, decoded one cell at a time."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        heads = write_ncnn(cfg, weights, folder)
        net = ncnn.Net()
        net.opt.use_fp16_packed = net.opt.use_fp16_storage = net.opt.use_fp16_arithmetic = False
        net.opt.num_threads = 1
        assert net.load_param(str(folder / "net.param")) == 0
        assert net.load_model(str(folder / "net.bin")) == 0
        small = cv2.resize(image_bgr, (SIDE, SIDE))[:, :, ::-1].transpose(2, 0, 1)
        extractor = net.create_extractor()
        pixels = np.ascontiguousarray(small, np.float32) / np.float32(255)
        blob = ncnn.Mat(pixels).clone()
        extractor.input("in", blob)
        rows = []
        for blob, anchors in heads:
            answer = extractor.extract(blob)[1]
            raw = np.array(answer)
            rows += decode(raw.reshape(len(anchors), 85, *raw.shape[1:]), anchors)
    return np.array(rows)


def decode(raw, anchors):
    def squash(x):
        return 1 / (1 + np.exp(-x))

    rows = []
    for a, (width, height) in enumerate(anchors):
        for r in range(raw.shape[2]):
            for c in range(raw.shape[3]):
                v = raw[a, :, r, c].astype(float)
                x, y = (squash(v[0]) + c) / raw.shape[3], (squash(v[1]) + r) / raw.shape[2]
                w, h = math.exp(v[2]) * width / SIDE, math.exp(v[3]) * height / SIDE
                rows.append([x, y, w, h, squash(v[4]), *(squash(v[4]) * squash(v[5:]))])
    return rows


def choose(rows, names, width, height):
    """Non-maximum suppression, one class after the other, one box after the other."""
    chosen = []
    for k, label in enumerate(names):
        boxes = []
        for row in sorted(rows[rows[:, 5 + k] >= CONFIDENCE], key=lambda row: -row[5 + k]):
            x, y, w, h = row[0] * width, row[1] * height, row[2] * width, row[3] * height
            box = (x - w / 2, y - h / 2, x + w / 2, y + h / 2)
            if all(iou(box, other) <= NMS_IOU for other, _ in boxes):
                boxes.append((box, row[5 + k]))
        chosen += [
            {"label": label, "confidence": round(float(p), 5), "xyxy": [round(float(v), 3) for v in box]}
            for box, p in boxes
        ]
    return sorted(chosen, key=lambda box: -box["confidence"])


def iou(a, b):
    w = min(a[2], b[2]) - max(a[0], b[0])
    h = min(a[3], b[3]) - max(a[1], b[1])
    if w <= 0 or h <= 0:
        return 0.0
    return w * h / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - w * h)


def main():
    data, models = Path(sys.argv[1]), Path(sys.argv[2])
    names = (models / "coco.names").read_text().split("\n")[:80]
    answers = []
    for variant in ("1.1", "1.1-xl"):
        files = [models / f"yolo-fastest-{variant}.{suffix}" for suffix in ("cfg", "weights")]
        for picture in PICTURES:
            image = cv2.imread(str(data / picture))
            height, width = image.shape[:2]
            for runtime, ask in (("opencv", ask_opencv), ("ncnn", ask_ncnn)):
                boxes = choose(ask(*files, image), names, width, height)
                answers.append({"variant": variant, "picture": picture, "runtime": runtime, "boxes": boxes})
                sys.stdout.write(f"{variant} {picture} {runtime}: {len(boxes)} boxes\n")
    made = {"opencv": cv2.__version__, "ncnn": ncnn.__version__, "by": "tests/golden/make_yolo_fastest_boxes.py"}
    note = "stretched to 320 x 320, RGB, / 255; xyxy from the left edge of the first pixel, not cut to the image"
    golden = {"made": made, "confidence": CONFIDENCE, "nms_iou": NMS_IOU, "note": note, "answers": answers}
    Path(__file__).with_name("yolo_fastest_boxes.json").write_text(json.dumps(golden, indent=1) + "\n")


if __name__ == "__main__":
    main()
