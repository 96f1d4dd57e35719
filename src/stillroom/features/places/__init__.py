"""Place recognition: a vocabulary of descriptors, and an index of the keyframes by their words."""
