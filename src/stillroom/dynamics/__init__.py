"""The sieves: rejection of dynamic features."""
