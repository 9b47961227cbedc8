"""Characters of users: their file, their skeleton's joints, and the body that stands for them in a drape."""
