"""Files of others and of ours, each read through one door that limits size and depth
(`given_file`).
"""
