"""Files of users: observations, scenes, motions, marks and rigs; CSV, npz and TOML with one kind of error message each."""
