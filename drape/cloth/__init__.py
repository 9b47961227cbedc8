"""Cloth: fabrics and their constants, energies of membrane, bending and contact, rest states, and the numbers by which
drapes are judged."""
