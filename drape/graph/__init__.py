"""What the graphs take: bodies, garments and outfits laid out as their inputs."""
