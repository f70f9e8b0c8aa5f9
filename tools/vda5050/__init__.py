"""`headland vda5050`: a delivering fleet as the vehicles of a VDA 5050 master control.

`transport_rules` reads what an order asks for, `order_book` keeps which task it became, `fleet_vehicle`
is one vehicle as the master sees it, and `master_gateway` connects both to the bus and the broker.
"""
