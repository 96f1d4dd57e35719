"""Networks in ONNX files: running them, and boxes of any detector among them."""
