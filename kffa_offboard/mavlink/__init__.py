"""Everything that knows MAVLink: links, identities, what differs between firmwares, and the loop.

`shell.run` joins the pieces: a link (`link.open_link`), our own identity (`component.Component`),
the translation of messages (`vehicle.Vehicle`) and a service that knows nothing of them.
"""
