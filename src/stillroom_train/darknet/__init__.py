"""Networks in darknet's own format, and the way from there to ONNX."""
