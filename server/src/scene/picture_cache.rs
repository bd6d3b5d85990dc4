//! Cache of pictures by content: a picture used by many meshes, files, scenes or sessions is decoded and stored only
//! once.

use std::collections::HashMap;
use std::collections::hash_map::RandomState;
use std::hash::BuildHasher;
use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError, Weak};

use super::{Reading, Texture};
use crate::memory::Held;

/// A picture and its share of the process's memory budget.
#[derive(Debug, Clone)]
pub(super) struct Picture {
    pub(super) texture: Arc<Texture>,
    pub(super) held: Arc<Held>,
}

/// The key of a picture: two keyed hashes of the encoded bytes, their length, and the reading mode. The hash keys are
/// random per process, so collisions cannot be crafted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
struct Key {
    hashes: [u64; 2],
    bytes: usize,
    reading: Reading,
}

/// A slot for one picture. The thread that decodes it holds the lock, and others wait for it.
type Slot = Arc<Mutex<Option<(Weak<Texture>, Weak<Held>)>>>;

/// Pictures in use.
#[derive(Debug, Default)]
pub(super) struct PictureCache {
    keys: [RandomState; 2],
    slots: Mutex<HashMap<Key, Slot>>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every critical section leaves its data consistent.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl PictureCache {
    /// The process-wide cache.
    pub(super) fn of_the_process() -> Arc<Self> {
        static SHARED: LazyLock<Arc<PictureCache>> = LazyLock::new(Arc::default);
        Arc::clone(&SHARED)
    }

    /// The picture for a file's bytes: the cached one, or else the result of `decode`.
    pub(super) fn get_or_decode(
        &self,
        bytes: &[u8],
        reading: Reading,
        decode: impl FnOnce() -> Result<(Texture, Held), String>,
    ) -> Result<Picture, String> {
        let key = Key {
            hashes: [0, 1].map(|i| self.keys[i].hash_one(bytes)),
            bytes: bytes.len(),
            reading,
        };
        let slot = {
            let mut slots = lock(&self.slots);
            if !slots.contains_key(&key) {
                // Slots of unused pictures are removed when new ones are added.
                slots.retain(|_, slot| Arc::strong_count(slot) > 1 || is_held(slot));
            }
            Arc::clone(slots.entry(key).or_default())
        };
        let mut place = lock(&slot);
        if let Some(picture) = place.as_ref().and_then(upgrade) {
            return Ok(picture);
        }
        let (texture, held) = decode()?;
        let picture = Picture {
            texture: Arc::new(texture),
            held: Arc::new(held),
        };
        *place = Some((
            Arc::downgrade(&picture.texture),
            Arc::downgrade(&picture.held),
        ));
        Ok(picture)
    }
}

fn upgrade((texture, held): &(Weak<Texture>, Weak<Held>)) -> Option<Picture> {
    Some(Picture {
        texture: texture.upgrade()?,
        held: held.upgrade()?,
    })
}

fn is_held(slot: &Slot) -> bool {
    // A locked slot is being decoded.
    slot.try_lock()
        .map_or(true, |place| place.as_ref().and_then(upgrade).is_some())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::memory::Budget;
    use crate::scene::Wrap;

    const COLORS: Reading = Reading {
        srgb: true,
        wrap: [Wrap::Repeat; 2],
    };

    fn picture(budget: &Budget) -> Result<(Texture, Held), String> {
        let texture = Texture::new(1, 1, vec![[1; 4]], true);
        Ok((texture, budget.take(4, "x").unwrap()))
    }

    #[test]
    fn of_the_same_bytes_there_is_one_until_nobody_holds_it() {
        let cache = PictureCache::default();
        let budget = Budget::new("x", 100);
        let never = || -> Result<(Texture, Held), String> { Err("decoded again".to_owned()) };
        let first = cache
            .get_or_decode(b"a", COLORS, || picture(&budget))
            .unwrap();
        let again = cache.get_or_decode(b"a", COLORS, never).unwrap();
        assert!(Arc::ptr_eq(&first.texture, &again.texture));
        // Another reading mode, or other bytes: another picture.
        assert!(
            cache
                .get_or_decode(b"a", Reading::default(), never)
                .is_err()
        );
        assert!(cache.get_or_decode(b"b", COLORS, never).is_err());
        assert_eq!(budget.held(), 4);
        drop((first, again));
        assert_eq!(budget.held(), 0);
        assert!(cache.get_or_decode(b"a", COLORS, never).is_err());
        // Slots of unused pictures are removed.
        for i in 0..100u8 {
            let _ = cache.get_or_decode(&[i, 1], COLORS, || picture(&budget));
        }
        assert!(lock(&cache.slots).len() <= 2);
    }

    #[test]
    fn those_who_ask_at_the_same_time_wait_for_one_decoder() {
        let cache = PictureCache::default();
        let budget = Budget::new("x", 100);
        let n = std::sync::atomic::AtomicUsize::new(0);
        let pictures: Vec<Picture> = std::thread::scope(|scope| {
            let ask = || {
                cache.get_or_decode(b"a", COLORS, || {
                    n.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    picture(&budget)
                })
            };
            let threads: Vec<_> = (0..8).map(|_| scope.spawn(ask)).collect();
            let join = |t: std::thread::ScopedJoinHandle<'_, Result<Picture, String>>| {
                t.join().unwrap().unwrap()
            };
            threads.into_iter().map(join).collect()
        });
        assert!(
            pictures
                .iter()
                .all(|p| Arc::ptr_eq(&p.texture, &pictures[0].texture))
        );
        assert_eq!(n.into_inner(), 1);
    }
}
