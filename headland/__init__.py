"""The one name that an installed Headland takes.

`__main__` is the command, `can_interface` what python-can loads for `interface="fieldbus"`.
In a wheel the layers are packages in here (`headland.agent`); in a checkout `checkout` finds them
beside this folder, under the same names.
"""

from pathlib import Path

if not Path(__file__).with_name("agent").is_dir():
    from headland.checkout import find_layers

    find_layers()
