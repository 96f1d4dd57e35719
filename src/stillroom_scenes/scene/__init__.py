"""What stands in the synthetic room: textures, furniture, light; and, in `people`, who walks in it."""
