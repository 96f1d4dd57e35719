"""PSPNet: the network, its training, and its export to ONNX. torch is imported only where it is used."""
