"""How good the drape is: quality, outfits, dynamics and push-out of the served model, and pictures of it."""
