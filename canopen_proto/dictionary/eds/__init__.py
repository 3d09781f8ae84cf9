"""EDS and DCF: the files of CiA 306 that describe a type of device, and one device."""
