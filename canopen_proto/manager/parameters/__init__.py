"""The values of a node's objects: read all of them, write a set of them.

backup.py    read all objects of a node: for a backup, a comparison, a dump
walk.py      the same without knowing which objects there are
restore.py   set a node to given values, in the order that CiA 302 asks for
"""
