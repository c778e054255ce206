"""Scene: a rock on lunar ground under the sun, photographed. Light is baked once; a frame is look-ups."""
