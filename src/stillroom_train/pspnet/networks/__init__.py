"""Networks as lists of steps, which torch trains and ONNX stores."""
