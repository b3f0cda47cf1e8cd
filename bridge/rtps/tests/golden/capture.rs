//! The datagrams of recorded conversations, see `README.md`.

const FAST_DDS: &[u8] = include_bytes!("fast_dds.pcap");
const CYCLONE_DDS: &[u8] = include_bytes!("cyclone_dds.pcap");

pub fn fast_dds() -> Vec<&'static [u8]> {
    datagrams(FAST_DDS)
}

pub fn cyclone_dds() -> Vec<&'static [u8]> {
    datagrams(CYCLONE_DDS)
}

/// The UDP payloads of a little-endian pcap file of Ethernet frames with IPv4 headers without options.
fn datagrams(file: &[u8]) -> Vec<&[u8]> {
    const FILE_HEADER: usize = 24;
    const RECORD_HEADER: usize = 16;
    const ETHERNET_IP_UDP: usize = 14 + 20 + 8;
    let (header, mut rest) = file.split_at(FILE_HEADER);
    assert_eq!(header[..4], [0xd4, 0xc3, 0xb2, 0xa1]);
    let mut datagrams = Vec::new();
    while let Some((record, following)) = rest.split_at_checked(RECORD_HEADER) {
        let length = u32::from_le_bytes([record[8], record[9], record[10], record[11]]);
        let (frame, following) = following.split_at(length as usize);
        datagrams.push(&frame[ETHERNET_IP_UDP..]);
        rest = following;
    }
    datagrams
}
