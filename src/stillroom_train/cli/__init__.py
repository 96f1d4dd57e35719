"""The commands of this package; what they need is imported when they run."""
