//! The newest datagram, written and copied at once.

use super::super::PoseDatagram;
use super::super::slot::Slot;

#[test]
fn readers_see_whole_datagrams_and_the_last_one() {
    let slot = Slot::new();
    assert_eq!(slot.load(), None);
    const STORED: u32 = 200_000;
    std::thread::scope(|scope| {
        let reader = scope.spawn(|| {
            let (mut last, mut copies) = (0, 0);
            while last < STORED {
                let Some(datagram) = slot.load() else {
                    continue;
                };
                let numbers = datagram.as_bytes().chunks_exact(4).map(|b| u32::from_le_bytes(b.try_into().unwrap()));
                let first = u32::from_le_bytes(datagram.as_bytes()[..4].try_into().unwrap());
                assert!(numbers.into_iter().all(|number| number == first) && first >= last, "{last}, {first}");
                last = first;
                copies += 1;
            }
            copies
        });
        for number in 1..=STORED {
            let mut bytes = [0; PoseDatagram::BYTES];
            bytes.chunks_exact_mut(4).for_each(|chunk| chunk.copy_from_slice(&number.to_le_bytes()));
            slot.store(&PoseDatagram::from_bytes(bytes));
        }
        assert!(reader.join().unwrap() > 0);
    });
}
