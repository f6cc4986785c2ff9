"""Files on this machine or in an object store, by their paths or addresses.

``finding.find_files``, ``fetching.fetch``, ``folder.Folder``, ``stored.StoredFile``, ``addresses.is_address``.
"""
