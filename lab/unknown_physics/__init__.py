"""Machines whose missing physics is in no library: how often is the answer an all-clear?"""
