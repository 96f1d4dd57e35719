"""Background inpainting in the manner of DynaSLAM: the image with what moves painted out."""
