"""Every motion file of one's own data is read."""

import numpy as np
import pytest

from drape.motion.clip import clean_windows, flagged_steps
from drape.motion.readers import MOTION_SUFFIXES, read_motion


@pytest.mark.data
def test_every_clip_of_the_data_folder_is_read_and_mostly_clean(data):
    files = sorted(path for path in (data / "motions").rglob("*") if path.suffix.lower() in MOTION_SUFFIXES)
    if not files:
        pytest.skip("The folder named by DRAPE_DATA has no motions; docs/guide/data.md says where they can be had.")
    for path in files:
        clip = read_motion(path)
        assert flagged_steps(clip).mean() < 0.2, path.name
        assert clip.resampled(30.0).frame_count <= clip.frame_count, path.name
        # A person's pelvis: above the ground and not in the air, most of the time.
        assert 0.3 < np.median(clip.trans[:, 1]) < 2.2, path.name
        if clip.frame_count >= 60:
            assert clean_windows(clip, 20), path.name
