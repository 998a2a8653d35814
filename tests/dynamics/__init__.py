"""Rods in motion: single steps against dense linear algebra, motions against theory, recorded motions and identification."""
