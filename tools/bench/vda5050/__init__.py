"""VDA 5050 against counterparts of others: a broker, a master control, vehicles, the official schemas.

`masters_orders` and `own_vehicles` are the two trials, `counterparts` what they speak to.
"""
