"""Files on a disk: formats of meshes, packed arrays, the folder of one's own data, and avatars by file name."""
