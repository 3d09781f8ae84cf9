"""The programs of a device (CiA 302-3).

identity.py   what 0x1F50 to 0x1F57 say of a program
objects.py    read these objects of a device that may be busy with its flash, or booting
download.py   write a new program, start it, and find out whether it runs
"""
