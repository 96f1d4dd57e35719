"""PSPNet: the network, how it learns, and how it becomes an ONNX file. torch is imported only where it is used."""
