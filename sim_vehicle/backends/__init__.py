"""The plant under real firmware: what carries motor commands in and sensor values out.

One module for each simulator interface that an autopilot's own software-in-the-loop build speaks.
"""
