"""Point clouds, embeddings, occlusion and touch: still an empty room in this release."""
