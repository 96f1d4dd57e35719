"""Those who walk about: bodies, clothes, gait, and who goes where."""
