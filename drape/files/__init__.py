"""What lies on a disk: file formats, data of one's own, and the avatar that a file name tells."""
