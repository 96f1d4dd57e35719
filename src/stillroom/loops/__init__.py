"""Coming back: places seen again are recognised, checked, and the map is made to agree with itself."""
