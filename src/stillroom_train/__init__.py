"""Training and export: PSPNet's weights, vocabularies, and ONNX files of darknet's networks.

Its commands reach the command line by entry points; `stillroom` itself never imports this package.
"""
