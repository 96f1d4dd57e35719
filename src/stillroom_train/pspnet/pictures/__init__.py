"""What a network learns from: pictures, what is known of their pixels, and how they are varied."""
