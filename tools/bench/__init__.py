"""Benches: every figure that a document of ours claims, one JSON line each (`figure`,
`command`).
"""
