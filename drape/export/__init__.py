"""Files that draped clips become: GLB for viewers, point caches and scenes for programs of animation."""
