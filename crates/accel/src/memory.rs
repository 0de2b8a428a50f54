//! Memory for large arrays that are read in random order: by pages of 2 MiB where the system has them, so that fewer reads
//! wait for the translation of their address.

/// Size of a huge page.
const HUGE_PAGE_BYTES: usize = 1 << 21;

/// An empty vector with room for `len` elements.
pub(crate) fn with_capacity<T>(len: usize) -> Vec<T> {
    let vec = Vec::with_capacity(len);
    advise(&vec);
    vec
}

/// A vector of the same elements, and no more room than they take.
pub(crate) fn settle<T: Copy>(from: Vec<T>) -> Vec<T> {
    let mut to = with_capacity(from.len());
    to.extend_from_slice(&from);
    to
}

/// Asks for huge pages where they fit as a whole. A system that has none to give doesn't, and nothing else changes.
#[cfg(target_os = "linux")]
fn advise<T>(vec: &Vec<T>) {
    let start = vec.as_ptr() as usize;
    let (first, end) = (
        start.next_multiple_of(HUGE_PAGE_BYTES),
        (start + vec.capacity() * size_of::<T>()) / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES,
    );
    if end > first {
        // SAFETY: all pages from `first` to `end` belong to the vector's allocation, and the advice changes no contents.
        unsafe { libc::madvise(first as *mut libc::c_void, end - first, libc::MADV_HUGEPAGE) };
    }
}

#[cfg(not(target_os = "linux"))]
fn advise<T>(_: &Vec<T>) {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn contents_stay_and_room_goes() {
        let mut grown = Vec::new();
        (0..3_000_000u64).for_each(|i| grown.push(i));
        let settled = settle(grown);
        assert!(settled.iter().copied().eq(0..3_000_000));
        assert_eq!(settled.capacity(), 3_000_000);
        assert!(settle(Vec::<u8>::new()).is_empty());
    }
}
