"""What cloth is: proof of the fabrics by the tests of textile laboratories, and a picture of it."""
