"""What the next experiment is chosen from and by: drives, tangents, separability."""
