"""What a Python process takes to answer at all: each datagram with bytes made before. Argument: port."""

from __future__ import annotations

import socket
import sys

from pymavlink.dialects.v20 import ardupilotmega as mavlink

if __name__ == "__main__":
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind(("127.0.0.1", int(sys.argv[1])))
    level = mavlink.MAVLink_set_attitude_target_message(
        0, 1, 1, 128, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.4
    )
    answer = level.pack(mavlink.MAVLink(None, srcSystem=245, srcComponent=191))
    while True:
        _, sender = listener.recvfrom(65535)
        listener.sendto(answer, sender)
